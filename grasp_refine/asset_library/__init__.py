"""Other people's hands, objects and grasps, by name: what there is, where it comes from, and fetching it."""
