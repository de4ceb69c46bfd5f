"""Grasp files: ours and those of other programs, one format a file."""
