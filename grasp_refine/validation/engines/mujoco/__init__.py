"""Grasps simulated by MuJoCo."""
