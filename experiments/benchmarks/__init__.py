"""Benchmarks: speed, memory and search, each against peers in the same run."""
