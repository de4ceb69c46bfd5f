"""Proof: what a grasp is worth, measured independently of how it was found."""
