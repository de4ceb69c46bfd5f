"""Patches of flat faces: closed forms of boxes, cuts that do not end a face, exact derivatives, engines that agree."""

from __future__ import annotations

import numpy as np
import pytest

from grasp_refine.collision.engine import engines
from grasp_refine.collision.query import Pairs, Witness, query
from grasp_refine.core.profiling import Stopwatch
from grasp_refine.core.se3 import exp_so3
from grasp_refine.geometry.body import Body, build_body
from grasp_refine.geometry.facets import Facets
from grasp_refine.geometry.pieces import Piece, box, capsule, cylinder, sphere
from grasp_refine.witness.face_patch import FacePairs, FacePatches

ENGINES = pytest.mark.parametrize("engine", engines())
OBJECT = build_body("object", [box([0.06, 0.04, 0.02])])
"""Its upper face is at z = 0.01."""


ZERO = np.zeros((1, 1), dtype=int)


def pose(x: float = 0.0, y: float = 0.0, z: float = 0.0, *turn: float) -> np.ndarray:
    T = np.eye(4)
    T[:3, :3] = exp_so3(np.array(turn or (0.0, 0.0, 0.0)))
    T[:3, 3] = x, y, z
    return T


def patch(link: Body, T: np.ndarray, obj: Body = OBJECT) -> tuple[FacePatches, Witness]:
    witness = query(Pairs((link,), (obj,)), T[None, None], np.eye(4)[None, None], cutoff=1.0)
    return FacePairs.of([link], [obj]).patches(ZERO, ZERO, T[None, None], witness, witness.valid), witness


def corners(found: FacePatches) -> np.ndarray:
    """Corners of the one patch, in lexicographic order."""
    points = found.point[0, 0, : found.count[0, 0]]
    return points[np.lexsort(points.round(9).T[::-1])]


def cut(extents: list[float], *places: float) -> list[Piece]:
    """A box cut across x."""
    ends = [-0.5 * extents[0], *places, 0.5 * extents[0]]
    return [box([b - a, *extents[1:]], pose(0.5 * (a + b))) for a, b in zip(ends[:-1], ends[1:], strict=True)]


@ENGINES
def test_a_cube_on_a_face_has_its_corners(engine: str, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("GRASP_REFINE_ENGINE", engine)
    cube = build_body("cube", [box([0.02, 0.02, 0.02])])
    found, _ = patch(cube, pose(0.005, 0.0, 0.0203))
    expected = [[x, y, 0.01] for x in (-0.005, 0.015) for y in (-0.01, 0.01)]
    np.testing.assert_allclose(corners(found), expected, atol=1e-12)
    np.testing.assert_allclose(found.gap[0, 0], 3e-4, atol=1e-12)
    np.testing.assert_allclose(found.normal[0, 0], [0, 0, -1], atol=1e-12)
    assert found.weight[0, 0] == 1.0
    # Half of it beyond the rim.
    found, _ = patch(cube, pose(0.03, 0.0, 0.02))
    expected = [[x, y, 0.01] for x in (0.02, 0.03) for y in (-0.01, 0.01)]
    np.testing.assert_allclose(corners(found), expected, atol=1e-9)


@ENGINES
def test_gaps_of_a_tilted_cube_are_in_closed_form(engine: str, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("GRASP_REFINE_ENGINE", engine)
    cube = build_body("cube", [box([0.02, 0.02, 0.02])])
    for angle in (1e-9, 1e-3, 0.1, 0.2):
        # About an edge of its lower face, which stays on the object.
        c, s = np.cos(angle), np.sin(angle)
        T = pose(0.0, 0.0, 0.01 + 0.01 * (c + s), 0.0, angle, 0.0)
        found, _ = patch(cube, T)
        x = corners(found)[:, 0]
        np.testing.assert_allclose(np.ptp(x), 0.02 * c, atol=1e-9)
        gap = np.sort(found.gap[0, 0])
        np.testing.assert_allclose(gap, [0.0, 0.0, 0.02 * s, 0.02 * s], atol=1e-9)
        # Turned by 12 degrees and more, a patch counts less and less.
        assert (found.weight[0, 0] == 1.0) == (angle < np.radians(12.0))


@ENGINES
@pytest.mark.parametrize("places", [(0.0,), (-0.021, 0.004, 0.0085)])
def test_cuts_of_the_decomposition_do_not_end_a_patch(engine: str, places: tuple, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("GRASP_REFINE_ENGINE", engine)
    cube = build_body("cube", [box([0.02, 0.03, 0.02])])
    cut_cube = build_body("cube", cut([0.02, 0.03, 0.02], 0.003))
    cut_object = build_body("object", cut([0.06, 0.04, 0.02], *places))
    T = pose(0.004, -0.008, 0.0203, 0.02, -0.03, 0.4)
    whole = corners(patch(cube, T)[0])
    assert len(whole) == 4
    for link, obj in ((cube, cut_object), (cut_cube, OBJECT), (cut_cube, cut_object)):
        np.testing.assert_allclose(corners(patch(link, T, obj)[0]), whole, atol=1e-9)


def test_a_patch_over_two_legs_reaches_from_one_to_the_other():
    legs = build_body("legs", [box([0.01, 0.01, 0.02], pose(x, 0.0)) for x in (-0.02, 0.02)])
    found, _ = patch(legs, pose(0.0, 0.0, 0.02))
    expected = [[x, y, 0.01] for x in (-0.025, 0.025) for y in (-0.005, 0.005)]
    np.testing.assert_allclose(corners(found), expected, atol=1e-9)


def test_a_narrow_overlap_is_a_segment_and_a_tiny_one_none():
    cube = build_body("cube", [box([0.02, 0.02, 0.02])])
    found, _ = patch(cube, pose(0.0397, 0.0, 0.02))
    assert found.count[0, 0] == 2
    np.testing.assert_allclose(np.linalg.norm(np.diff(corners(found), axis=0)), 0.02, rtol=1e-3)
    assert patch(cube, pose(0.0395, 0.0295, 0.02))[0].count[0, 0] == 0


@pytest.mark.parametrize(
    "piece",
    [sphere(0.01), capsule(0.01, (0, 0, 0.02), (0, 0, -0.02)), cylinder(0.02, 0.004)],
    ids=["sphere", "capsule", "mantle"],
)
def test_nothing_flat_costs_nothing(piece: Piece):
    body = build_body("round", [piece])
    assert (np.abs(Facets.of([piece]).normal[:, 2]) > 0.5).all(), "a mantle is no face, however finely it is cut"
    with Stopwatch() as watch:
        found, witness = patch(body, pose(0.0, 0.0, 0.04, np.pi / 2, 0.0, 0.0))
    assert not found.count.any() and witness.valid.all()
    assert watch.patches == (len(body.facets) > 0)


def test_corners_and_gaps_have_exact_derivatives():
    rng = np.random.default_rng(0)
    wedge = build_body("wedge", cut([0.03, 0.02, 0.02], 0.004))
    pairs = FacePairs.of([wedge], [OBJECT])
    for _ in range(20):
        T = pose(*rng.uniform(-0.02, 0.02, 2), 0.022, *rng.uniform(-0.1, 0.1, 2), rng.uniform(-3, 3))
        found, witness = patch(wedge, T)

        def at(twist: np.ndarray, T: np.ndarray = T, witness: Witness = witness) -> FacePatches:
            new = np.eye(4)
            new[:3, :3] = exp_so3(twist[3:]) @ T[:3, :3]
            new[:3, 3] = exp_so3(twist[3:]) @ T[:3, 3] + twist[:3]
            return pairs.patches(ZERO, ZERO, new[None, None], witness, witness.valid)

        assert found.count[0, 0] == 4
        for k in range(6):
            step = np.zeros(6)
            step[k] = 1e-6
            ahead, behind = at(step), at(-step)
            for name, derivative in (("point", found.motion[..., k]), ("gap", found.slope[..., k])):
                difference = (getattr(ahead, name) - getattr(behind, name)) / 2e-6
                np.testing.assert_allclose(derivative, difference, atol=1e-6)


@pytest.mark.skipif(len(engines()) < 2, reason="not compiled")
def test_both_engines_find_the_same(monkeypatch: pytest.MonkeyPatch):
    rng = np.random.default_rng(1)
    link = build_body("link", [*cut([0.03, 0.02, 0.02], 0.004), cylinder(0.012, 0.02, pose(0.02))])
    obj = build_body("object", cut([0.06, 0.04, 0.02], 0.0, 0.01))
    for _ in range(40):
        T = pose(*rng.uniform(-0.03, 0.03, 2), 0.021, *rng.uniform(-0.15, 0.15, 2), rng.uniform(-3, 3))
        found = []
        for engine in ("native", "python"):
            monkeypatch.setenv("GRASP_REFINE_ENGINE", engine)
            found.append(patch(link, T, obj)[0])
        for name in ("count", "normal", "weight", "point", "gap", "motion", "slope"):
            np.testing.assert_allclose(*(getattr(one, name) for one in found), atol=1e-9, err_msg=name)
