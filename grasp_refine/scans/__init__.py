"""Scans: objects that sensors saw in part, and the solids that they may be."""
