"""Solvers: Levenberg-Marquardt, normalised gradient descent, Adam."""
