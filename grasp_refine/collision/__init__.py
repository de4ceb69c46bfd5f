"""Collision queries: which pieces can matter, their closest or deepest points, the minimum over each body pair."""
