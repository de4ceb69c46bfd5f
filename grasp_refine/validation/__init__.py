"""Validation of grasps: geometric measures, and simulation in MuJoCo."""
