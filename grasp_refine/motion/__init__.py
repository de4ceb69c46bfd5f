"""Trajectories of grasps: approach, pregrasp, grasp, squeeze and lift, checked for collisions, and timed."""
