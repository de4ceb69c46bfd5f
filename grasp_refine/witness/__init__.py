"""Witness points as a differentiable layer: how closest or deepest points follow the motion of two bodies."""
