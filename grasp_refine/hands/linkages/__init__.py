"""Mechanisms of hands: coupled joints, tendons, linkages with springs, servos."""
