"""Share of grasps of grippers that hold before and after refinement, sampled and perturbed ones."""
