"""Exit codes of commands."""

NOTHING_USABLE = 1
"""Exit code when there are no usable results."""
