"""Errors, rigid motions, arrays in records, profiling and files: used by every other folder."""
