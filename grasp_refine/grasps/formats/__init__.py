"""Formats of grasp files, ours and other programs', one per file."""
