"""Measures of the shown grasp, kept for as long as they hold."""
