"""Protocols of grasp tests in simulation: one value each, with its source, and what differs from it."""
