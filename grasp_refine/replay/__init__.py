"""Simulations to be looked at: recorded, exported to any MuJoCo, drawn."""
