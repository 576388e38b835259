"""Archipelagos: their plan, the processes and machines that hold islands, and the exchanges between islands."""
