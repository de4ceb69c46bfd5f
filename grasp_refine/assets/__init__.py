"""Hands, objects and grasps that come with the program or can be fetched by name."""
