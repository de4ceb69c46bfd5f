"""New grasps of a hand on an object."""
