"""What a user runs: commands, runs, sweeps, the certificate and benchmarks."""
