"""Scripts that make the files that come with the program: example grasps, convex pieces, pictures."""
