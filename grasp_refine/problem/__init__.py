"""From a specification of hand, object and grasps to refined and validated grasps."""
