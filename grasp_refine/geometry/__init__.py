"""Rigid bodies: meshes in, convex pieces and surface candidates out."""
