"""Closing of a hand on an object: pregrasp, squeeze, and the motion between."""
