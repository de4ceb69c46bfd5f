"""Regression gate of speed and quality: ratios of one run, against a committed baseline."""
