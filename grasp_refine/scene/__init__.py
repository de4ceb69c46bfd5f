"""A hand, an object and grasps together: which links should touch, and their queries."""
