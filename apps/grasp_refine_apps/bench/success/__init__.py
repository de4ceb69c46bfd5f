"""Success rate of grasps in simulation: as given and refined, by hand, object, source of the grasps and protocol."""
