"""Draw the README's picture: an embedded grasp of the mug before and after refinement.

Run `python -m grasp_refine_apps.authoring.picture` after anything that changes the example or the refinement. It writes
robots/allegro/example.png.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from grasp_refine.assets.embedded import resource_dir
from grasp_refine.core.array_types import UInt8
from grasp_refine.core.se3 import transform_from_pose
from grasp_refine.grasps.grasp_set import load_grasps, match_joints
from grasp_refine.hands.hand import load_hand
from grasp_refine.measures.geometry import Geometry, measure
from grasp_refine.objects.object import load_object
from grasp_refine.refinement.refine import Scene, refine
from grasp_refine.scene.hand_object import HandObject
from grasp_refine_apps.report.drawing import BAD, GOOD, INK, font, photograph, write
from grasp_refine_apps.report.rasterizer import Camera
from grasp_refine_apps.report.skeleton import Skeleton, object_model

OBJECT, EXAMPLE_ROW = "mug", 0
"""Object of the shown grasp, and row of the grasp in its example file."""
WIDTH, HEIGHT = 700, 600
"""Pixels of each half."""
OVERSAMPLING = 2
"""Factor by which the picture is drawn larger, then averaged for smooth edges."""
SIDE, TARGET_M, EXTENT_M = (0.722, -0.224, 0.338), (-0.012, 0.004, 0.072), 0.235
"""Direction towards the camera, target point and visible height in metres, object frame."""
LIGHT_DIRECTION = (0.5, -0.45, 1.0)
"""Direction towards the light, object frame."""
OBJECT_OPACITY = 0.8
"""Opacity of the object; a little of the fingers behind and inside it shows through."""
CONTACT_DISTANCE_M = 0.0005
"""Gap and depth below which a contact is drawn, metres."""


def annotate(draw: ImageDraw.ImageDraw, camera: Camera, title: str, geometry: Geometry, contacts: int) -> None:
    """Write the title and the two measures, and mark the contacts of the first `contacts` links."""
    s = OVERSAMPLING
    error, depth = np.nanmax(geometry.contact_error[0]), geometry.penetration[0]
    draw.text((28 * s, 20 * s), title, fill=INK, font=font(36 * s))
    summary = f"contact error {_mm(error)}, penetration {_mm(depth)}"
    draw.text((28 * s, 66 * s), summary, fill=GOOD if error < CONTACT_DISTANCE_M else BAD, font=font(23 * s))
    for k in range(contacts):
        points = geometry.witness.point_a[0, k], geometry.witness.point_b[0, k]
        _mark(draw, camera, *points, geometry.distance[0, k])


def _mark(
    draw: ImageDraw.ImageDraw, camera: Camera, on_link: np.ndarray, on_object: np.ndarray, distance: float
) -> None:
    """Draw two witness points (3,) with their signed distance beside them."""
    s = OVERSAMPLING
    link, obj = (camera.project(point)[:2] for point in (on_link, on_object))
    if abs(distance) < CONTACT_DISTANCE_M:
        color, kind = GOOD, ""
    else:
        color, kind = BAD, " gap" if distance > 0 else " inside"
    side, anchor = (1.0, "lm") if link[0] > 0.5 * camera.width else (-1.0, "rm")
    label = link + np.array([62 * side, 26]) * s
    draw.line([*link, *label], fill=INK, width=s)
    draw.line([*link, *obj], fill=color, width=5 * s)
    for x, y in (link, obj):
        r = 6 * s
        draw.ellipse([x - r, y - r, x + r, y + r], fill=color, outline="white", width=2 * s)
    write(draw, (label[0] + 6 * s * side, label[1]), _mm(abs(distance)) + kind, 22 * s, color, anchor)


def _mm(metres: float) -> str:
    """Format a length (metres) in millimetres, with two decimals below 1 mm."""
    value = 1e3 * metres
    return f"{value:.1f} mm" if value >= 1 else f"{value:.2f} mm"


def draw_example() -> UInt8[np.ndarray, "H W 3"]:
    """Draw the picture, uint8 red, green, blue."""
    hand, obj = load_hand("allegro"), load_object(OBJECT)
    grasps = load_grasps(resource_dir("robots") / "allegro" / f"example_{OBJECT}.npz").select([EXAMPLE_ROW])
    q, _ = match_joints(grasps, hand)
    scene = Scene(hand, obj, transform_from_pose(grasps.hand_pose), q)
    refined = refine(scene)
    camera = Camera(np.array(SIDE), np.array(TARGET_M), OVERSAMPLING * WIDTH, OVERSAMPLING * HEIGHT, EXTENT_M)
    drawn, solid = Skeleton.of(hand, visual=True), object_model(obj, OBJECT_OPACITY)
    halves = []
    for title, T, q in (
        ("Before", scene.T_world_root, scene.q),
        ("After refinement", refined.T_world_root, refined.q),
    ):
        geometry = measure(
            HandObject.of(scene), T, q, refined.target_link, refined.target_object, touching=refined.touching
        )
        photo = photograph([*drawn.posed(T[0], q[0]), solid], camera, np.array(LIGHT_DIRECTION))
        annotate(ImageDraw.Draw(photo), camera, title, geometry, len(hand.contacts))
        halves.append(photo.resize((WIDTH, HEIGHT), Image.Resampling.BOX))
    return np.concatenate([np.asarray(half) for half in halves], axis=1)


def main(arguments: list[str] | None = None) -> None:
    """Write the picture."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=None, help="file to write [robots/allegro/example.png]")
    path = parser.parse_args(arguments).out or resource_dir("robots") / "allegro" / "example.png"
    Image.fromarray(draw_example()).save(path, optimize=True)
    print(f"{path}: {path.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main()
