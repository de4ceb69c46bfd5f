"""The viewer: a page where grasps are seen, refined, steered, proved, browsed and taken away."""
