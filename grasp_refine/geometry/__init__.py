"""Meshes, convex pieces and their cache, surface samples."""
