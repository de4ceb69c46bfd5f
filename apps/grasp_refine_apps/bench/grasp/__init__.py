"""How accurate and how fast grasps are refined, by solver and batch size."""
