"""Transfer of grasps from one hand to another: the same fingers touch the same places, from the same side."""
