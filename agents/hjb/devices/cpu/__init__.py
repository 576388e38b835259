"""The CPU: compiled kernels, see `device`."""
