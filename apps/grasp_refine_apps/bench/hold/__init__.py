"""How many grasps hold after refinement, against what it costs, by method and number of starts."""
