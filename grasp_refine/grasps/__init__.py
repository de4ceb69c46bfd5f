"""Sets of grasps of one hand, and changes of their base link."""
