"""Grasps of one hand transferred to others: ours against joint copy and inverse kinematics."""
