"""Descriptions of hands as files have them: URDF, MJCF, hand.toml, meshes, the tree of links."""
