"""Refinement of grasps: configuration, losses, problem, search and the function `refine`."""
