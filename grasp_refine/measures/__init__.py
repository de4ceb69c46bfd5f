"""Measures of grasps, from their geometry alone."""
