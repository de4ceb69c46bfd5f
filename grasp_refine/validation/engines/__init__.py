"""Simulators of grasps."""
