"""HTML page of `run` and `validate`: a card for each grasp."""
