"""Runs: their config, their folder, forks and sweeps."""
