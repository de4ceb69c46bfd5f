"""Benchmarks: what the parts cost, measured against named peers in the same run."""
