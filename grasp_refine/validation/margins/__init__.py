"""Margins of grasps: how probably they hold in worlds that differ from the protocol's, and what they hold at most."""
