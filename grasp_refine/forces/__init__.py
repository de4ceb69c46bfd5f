"""Contact wrenches, equilibrium, grasp quality and squeeze."""
