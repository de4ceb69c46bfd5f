"""Study of scenes and arms: grasps within reach, trajectories free of collision, objects held and lifted."""
