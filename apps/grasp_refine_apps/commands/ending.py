"""How commands end: with an exit code."""

NOTHING_USABLE = 1
"""Exit code when nothing usable came out."""
