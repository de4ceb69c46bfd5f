"""Solvers: how root pose and joint values move to lower the loss."""
