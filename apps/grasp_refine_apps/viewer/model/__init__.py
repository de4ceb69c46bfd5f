"""Values that the viewer shows: grasps, poses, results, recordings, and the state that holds them."""
