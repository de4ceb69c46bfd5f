"""Draw the picture of the guide on scans: a depth picture of a mug, the solids that it may be, and a refined grasp.

Run `python -m grasp_refine_apps.authoring.scan_picture` after anything that changes completions or the refinement. It
writes docs/pages/figures/scan.png.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from grasp_refine.core.array_types import UInt8
from grasp_refine.core.se3 import transform_from_pose
from grasp_refine.hands.hand import load_hand
from grasp_refine.objects.object import Object, load_object
from grasp_refine.problem.facade import refine
from grasp_refine.sampling.sample import sample_grasps
from grasp_refine.scans.depth_camera import D435, depth_of, scan_of_depth, views_around, with_mask_errors, with_noise
from grasp_refine.scene.task import Task
from grasp_refine_apps.report.drawing import INK, font, photograph
from grasp_refine_apps.report.rasterizer import Camera
from grasp_refine_apps.report.skeleton import Skeleton, object_model

OBJECT, HAND, VIEW_SEED, GRASPS = "mug", "allegro", 3, 8
"""Object, hand, seed of the camera, and number of sampled grasps; the best one is drawn."""
PANEL, OVERSAMPLING = 480, 2
"""Pixels of each panel, and the factor by which it is drawn larger."""
BESIDE = (0.2, -1.0, 0.45)
"""Direction towards the eye, across the line of sight of the camera: the side that was not seen shows."""
LIGHT_DIRECTION = (0.5, -0.45, 1.0)
"""Direction towards the light."""
SEEN = (201, 88, 45)
"""Colour of seen points."""


def draw() -> UInt8[np.ndarray, "H W 3"]:
    """Return the picture, red, green, blue."""
    mesh = load_object(OBJECT).mesh
    (pose,) = views_around(mesh, 1, VIEW_SEED)
    exact = depth_of(mesh, pose)
    depth, mask = with_noise(exact, VIEW_SEED), with_mask_errors(exact > 0, VIEW_SEED)
    table = float(mesh.bounds[0, 2])
    obj = load_object(scan_of_depth([depth], [mask], D435, [pose]), name=OBJECT, table=table)
    hand = load_hand(HAND)
    refined = refine(hand, obj, sample_grasps(hand, obj, GRASPS, task=Task(table=table)), task=Task(table=table))
    best = int(np.argmax(refined.quality[:, 1]))
    size = PANEL * OVERSAMPLING
    side = np.array(BESIDE)
    around = np.array(mesh.bounds)
    near = Camera.fitted(side, np.concatenate([around, obj.scan.points if obj.scan else around]), size, size, 0.5)
    drawn = Skeleton.of(hand, visual=True).posed(
        transform_from_pose(refined.after.hand_pose[best]), refined.after.q[best]
    )
    far = Camera.fitted(side, np.concatenate([around, *(model.vertices for model in drawn)]), size, size, 0.2)
    panels = (
        ("Depth and mask", _depth(depth, mask)),
        ("Seen points, first solid", _solid(obj, near)),
        (f"Grasp: {refined.quality[best, 1]:.0%} to hold", photograph([*drawn, object_model(obj, 0.8)], far, _light())),
    )
    for title, panel in panels:
        ImageDraw.Draw(panel).text((40, 24), title, fill=INK, font=font(44))
    return np.concatenate([np.asarray(panel.resize((PANEL, PANEL), Image.Resampling.BOX)) for _, panel in panels], 1)


def _light() -> np.ndarray:
    return np.array(LIGHT_DIRECTION)


def _depth(depth: np.ndarray, mask: np.ndarray) -> Image.Image:
    """Return the depth within the mask, near ones dark, cut out."""
    rows, columns = (np.flatnonzero(mask.any(axis=axis)) for axis in (1, 0))
    half = int(0.75 * max(np.ptp(rows), np.ptp(columns)))
    middle = int(rows.mean()), int(columns.mean())
    cut = tuple(slice(at - half, at + half) for at in middle)
    near, seen = depth[cut], mask[cut] & (depth[cut] > 0)
    low, high = np.percentile(near[seen], [1, 99])
    grey = np.where(seen, 60 + 150 * np.clip((near - low) / (high - low), 0, 1), 255).astype(np.uint8)
    size = PANEL * OVERSAMPLING
    return Image.fromarray(grey).convert("RGB").resize((size, size), Image.Resampling.NEAREST)


def _solid(obj: Object, camera: Camera) -> Image.Image:
    """Return the first solid, with the points that were seen."""
    assert obj.scan is not None
    panel = photograph([object_model(obj, 0.6)], camera, _light())
    pen = ImageDraw.Draw(panel)
    for x, y, _ in camera.project(obj.scan.points[::3]):
        pen.ellipse([x - 2, y - 2, x + 2, y + 2], fill=SEEN)
    return panel


if __name__ == "__main__":
    path = Path(__file__).resolve().parents[3] / "docs" / "pages" / "figures" / "scan.png"
    Image.fromarray(draw()).save(path, optimize=True)
