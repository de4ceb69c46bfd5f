"""A tiny folder of assets for the evidence: two hands, two objects, and the grasps of a generator."""

import shutil
from pathlib import Path

import numpy as np

from grasp_refine.assets.embedded import resource_dir
from grasp_refine.objects.object import load_object
from plate_gripper import URDF

OBJECTS = {"ball": 0.04, "my_rounded_box": 1.0}
"""Name of each object -> its suggested scale."""


def write_assets(folder: Path) -> Path:
    """Write the assets; the ball has a diameter of 2 / sqrt(3), so that its bounding box has a diagonal of 2."""
    ours = resource_dir("robots") / "allegro"
    for name in ("hands/allegro", "hands/allegro_mjcf", "hands/plates", "objects", "grasps/normalised"):
        (folder / name).mkdir(parents=True)
    shutil.copy(ours / "allegro.urdf", folder / "hands/allegro/allegro.urdf")
    (folder / "hands/allegro_mjcf/right.xml").write_text("<mujoco/>")
    (folder / "hands/plates/plates.urdf").write_text(URDF)
    lines = ["name,suggested_scale,diag,convexity"]
    for name, source in (("ball", f"sphere:{1 / 3**0.5}"), ("my_rounded_box", "rounded_box")):
        mesh = load_object(source, unit="m").mesh
        mesh.export(folder / "objects" / f"{name}.obj")
        diagonal = 2.0 if name == "ball" else float(np.linalg.norm(mesh.extents))
        lines.append(f"{name},{OBJECTS[name]},{diagonal},0.95")
    (folder / "objects.csv").write_text("\n".join(lines))
    with np.load(ours / "example_rounded_box.npz") as entries:
        np.savez(folder / "grasps/normalised/made.npz", **entries)
    return folder
