"""Archipelagos: their plan, the processes and machines that hold islands, and what passes between these."""
