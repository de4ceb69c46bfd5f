"""Charts of the margins of grasps, as a page."""
