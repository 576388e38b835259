"""Benchmarks: the speed of the world and the cost of learners."""
