"""Scans: objects of which sensors saw a part, and the solids that they may be."""
