"""The viewer: a page where grasps are displayed, refined, edited, validated, browsed and exported."""
