"""Accuracy and speed of refining grasps, by solver and batch size."""
