"""Margins of grasps: probability of holding in worlds that differ from the protocol's, and largest load."""
