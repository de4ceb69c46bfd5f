"""The 3D scene: shapes, nodes, cameras, and clicks in it."""
