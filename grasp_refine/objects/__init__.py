"""Objects: meshes, primitives, folders of convex pieces."""
