"""Hands: URDF and hand.toml, forward kinematics, self-collision."""
