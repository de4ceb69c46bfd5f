"""Pictures and captions of failures: the facts are those of scenes made by hand."""

from __future__ import annotations

import io
from dataclasses import replace

import numpy as np
import pytest

Image = pytest.importorskip("PIL.Image", reason="Pillow comes with the extra 'test'")

from grasp_refine.collision.query import Pairs, query  # noqa: E402
from grasp_refine.core.se3 import exp_se3  # noqa: E402
from grasp_refine.geometry.body import Body, build_body  # noqa: E402
from grasp_refine.geometry.pieces import Piece, box, capsule, hull, sphere  # noqa: E402
from grasp_refine_apps.bench.align import failures  # noqa: E402
from grasp_refine_apps.bench.align.failures import Failure, WitnessPoints, caption, feature, picture, place  # noqa: E402

CUBE = build_body("cube", [box([0.04, 0.04, 0.04])])
# Two boxes that meet at the edge x = 0, z = 0.02: an inner corner.
CORNER = build_body(
    "corner",
    [
        hull([(x, y, z) for x in (0.0, 0.06) for y in (-0.03, 0.03) for z in (0.0, 0.02)]),
        hull([(x, y, z) for x in (-0.02, 0.0) for y in (-0.03, 0.03) for z in (0.0, 0.06)]),
    ],
)
PIN = build_body("pin", [hull([[0, 0, 0], [0.01, 0, 0.03], [-0.01, 0.01, 0.03], [-0.01, -0.01, 0.03]])])


def ended(
    a: Body,
    b: Body,
    origin: tuple[float, float, float],
    *,
    method: str = "distance",
    target_a: tuple[float, float, float] = (0.0, 0.0, 0.02),
    target_b: tuple[float, float, float] = (0.0, 0.0, 0.0),
    turn: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> Failure:
    """Body a turned about the origin of the world, and body b beside it in the same frame."""
    T_a = exp_se3(np.array([0.0, 0.0, 0.0, *turn]))
    shift = np.eye(4)
    shift[:3, 3] = origin
    T_b = T_a @ shift
    w = query(Pairs((a,), (b,)), T_a[None, None], T_b[None, None])
    witness = WitnessPoints(
        w.point_a[0, 0], w.point_b[0, 0], w.normal[0, 0], float(w.distance[0, 0]), int(w.winner[0, 0])
    )
    return Failure(
        method, "convex", "face-vertex", a, b, T_a, T_b, np.array(target_a), np.array(target_b), 0.0, witness
    )


@pytest.mark.parametrize(
    ("piece", "point", "normal", "expected"),
    [
        (box([2, 2, 2]), (1, 1, 1), (0, 0, 1), "vertex"),
        (box([2, 2, 2]), (1, 0.2, 1), (0, 0, 1), "edge"),
        (box([2, 2, 2]), (0.1, 0.2, 1), (0, 0, 1), "face"),
        # On the diagonal that cuts the square into two triangles.
        (box([2, 2, 2]), (0, 0, 1), (0, 0, 1), "face"),
        # As a query with a loose tolerance might answer.
        (box([2, 2, 2]), (0.1, 0.2, 1.0001), (0, 0, 1), "face"),
        (box([2, 2, 2]), (1, 1 + 1e-6, 1 - 1e-6), (0, 0, 1), "vertex"),
        (sphere(1.0), (0, 0, 1), (0, 0, 1), "round surface"),
        (capsule(1.0, (0, 0, 0), (1, 0, 0)), (0.5, 0, 1), (0, 0, 1), "round surface"),
    ],
)
def test_the_feature_below_a_point(piece: Piece, point: tuple, normal: tuple, expected: str):
    assert feature(piece, np.array(point, dtype=float), np.array(normal, dtype=float)) == expected


def test_a_place_is_concave_only_near_a_piece_that_rises():
    floor, up = CORNER.pieces[0], np.array([0.0, 0.0, 1.0])
    near = place(CORNER, floor, np.array([0.001, 0.0, 0.02]), up)
    assert near.beside == pytest.approx(0.001)
    assert place(CORNER, floor, np.array([0.05, 0.0, 0.02]), up).beside is None
    # Seen from below, the same corner is flat.
    assert place(CORNER, floor, np.array([0.001, 0.0, 0.0]), -up).beside is None


def test_the_caption_names_a_vertex_on_a_face_apart():
    words = caption(ended(CUBE, PIN, (0.01, 0.0, 0.0221), method="analytical + EG", turn=(0.4, -1.0, 2.0)))
    assert words.startswith("The bodies are 2.1 mm apart (0 mm desired); ")
    assert "on a face of body a and at a vertex of body b, 10.0 mm and 0 mm from the targets." in words
    # The vertex is on its target, so that it is not what is missing.
    assert "At a vertex" not in words
    missed = caption(ended(CUBE, PIN, (0.01, 0.0, 0.0221), method="analytical", target_b=(0.01, 0.0, 0.03)))
    assert "At a vertex the analytical derivative is zero" in missed


def test_the_caption_tells_penetration():
    inside = ended(CUBE, PIN, (0.003, 0.0, 0.018), method="zeroth-order")
    assert caption(inside).startswith("The bodies penetrate by 2.0 mm (0 mm desired); ")
    assert "In penetration" in caption(inside)
    assert "In penetration" not in caption(replace(inside, method="distance"))


def test_the_caption_tells_a_touch_without_a_sign():
    touching = ended(CUBE, PIN, (0.01, 0.0, 0.020001), method="direction")
    assert caption(touching).startswith("The bodies touch; ")
    assert "the direction between the witness points" in caption(touching)
    face = ended(CUBE, PIN, (0.01, 0.0, 0.021), method="direction")
    assert "All points of a face" in caption(face)


def test_the_caption_tells_a_concave_place():
    words = caption(ended(CORNER, PIN, (0.0105, 0.0, 0.021), target_a=(0.0, 0.0, 0.05)))
    assert "concave" not in words
    thin = build_body("needle", [hull([[0, 0, 0], [2e-4, 0, 0.03], [-1e-4, 1e-4, 0.03], [-1e-4, -1e-4, 0.03]])])
    words = caption(ended(CORNER, thin, (0.0015, 0.0, 0.0205), target_a=(0.0, 0.0, 0.05)))
    assert "Body a is concave there: another piece of it rises 1.5 mm from its witness point." in words
    assert "can change at once" in words


def test_the_error_is_that_of_the_benchmark():
    failure = ended(CUBE, PIN, (0.01, 0.0, 0.022))
    assert failure.error == pytest.approx(0.01**2 + 0.002**2, rel=1e-6)


def test_a_query_without_an_answer_is_said():
    failure = ended(CUBE, PIN, (0.01, 0.0, 0.022))
    none = WitnessPoints(np.zeros(3), np.zeros(3), np.zeros(3), np.nan, -1)
    assert "no witness points" in caption(replace(failure, witness=none))


def counts(png: bytes) -> tuple[int, int]:
    """How many pixels are bluish and how many orange."""
    r, g, b = np.asarray(Image.open(io.BytesIO(png)).convert("RGB")).astype(int).transpose(2, 0, 1)
    return int((b > r + 25).sum()), int((r > b + 60).sum())


@pytest.mark.parametrize("size", [1.0, 0.1])
def test_the_picture_shows_both_bodies_at_any_size_the_same_way_each_time(monkeypatch: pytest.MonkeyPatch, size: float):
    monkeypatch.setattr(failures, "OVERSAMPLING", 1)
    cube = build_body("cube", [box(np.full(3, 0.04 * size))])
    ball = build_body("ball", [sphere(0.02 * size)])
    failure = ended(cube, ball, (0.01 * size, 0.0, 0.042 * size), target_a=(0, 0, 0.02 * size), turn=(1.0, -2.0, 0.5))
    png = picture(failure)
    with Image.open(io.BytesIO(png)) as image:
        assert image.size == (failures.WIDTH, failures.HEIGHT) and image.format == "PNG"
    blue, orange = counts(png)
    assert blue > 10_000 and orange > 10_000
    if size == 1.0:
        assert picture(failure) == png


def test_the_view_is_from_a_side_where_nothing_hides_the_marks():
    wall = build_body("wall", [*CUBE.pieces, hull(np.array(box([0.002, 0.2, 0.2]).vertices) + [0.03, 0.0, 0.0])])
    failure = ended(wall, PIN, (0.0, 0.0, 0.022))
    interest = np.concatenate([failure.points, failure.targets])
    turn = failures._upright(failure.witness.normal)
    direction = turn.T @ failures._viewpoint(failure, turn, interest, (interest - interest.mean(0)) @ turn.T)
    assert np.linalg.norm(direction) == pytest.approx(1.0)
    assert abs(direction @ failure.witness.normal) < 0.5
    assert direction[0] < 0.1
    assert not any(failures._hidden(failure, point, direction[None]).any() for point in interest)
    assert failures._hidden(failure, failure.witness.point_b, np.array([[1.0, 0.0, 0.0]]))[0] > 0
