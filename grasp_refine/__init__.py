"""grasp-refine: refine the grasps of a robot hand with differentiable collision detection.

Conventions, in every file:

- SI units: metres, radians, kilograms, newtons. Millimetres and degrees appear only in what a person reads.
- The world frame is the object frame unless a scene says otherwise.
- `T_world_link` (4, 4) maps link coordinates to world coordinates; a point carries its frame in its name.
- Quaternions are (w, x, y, z). Twists are (v, w), spatial ones at the world origin: V(p) = v + w x p.
- A normal points from body a to body b; the signed distance n . (x_b - x_a) is negative in penetration.
- The contact margin is a distance >= 0 in metres.
- float64 by default, float32 on request. Seeds, device and dtype travel with the scene: same seed, same
  machine, same result.

Importing the package loads nothing else; import the module you need.
"""

__version__: str


def __getattr__(name: str) -> str:
    """Return `__version__`, read from the installed metadata when asked for, because that import is slow."""
    if name != "__version__":
        raise AttributeError(f"module 'grasp_refine' has no attribute '{name}'")
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version("grasp-refine")
    except PackageNotFoundError:
        return "0+not.installed"
