"""Evidence at scale: many hands, objects and generators of grasps, as given, by geometry only, and refined."""
