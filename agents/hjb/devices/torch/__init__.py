"""Other devices: all agents at once by torch, see `device`."""
