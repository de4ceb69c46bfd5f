"""Whether the program is still as fast and as good as it was: ratios of one run, against a committed baseline."""
