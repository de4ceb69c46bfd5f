"""What the files of a hand say (URDF, meshes, hand.toml), checked."""
