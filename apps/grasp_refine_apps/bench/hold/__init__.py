"""Share of grasps that hold after refinement, against the cost, by method and number of starts."""
