"""Grasps refined on scans of an object, tried on the object itself."""
