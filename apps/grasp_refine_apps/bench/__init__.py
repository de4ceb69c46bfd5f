"""Benchmarks: costs of the parts, measured against named peers in the same run."""
