"""Study of what scenes and arms leave of grasps: reachable, free on the whole way, held and lifted."""
