"""Recorded simulations: pictures, films, and scenes for MuJoCo."""
