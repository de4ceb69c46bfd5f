"""Solids that scanned objects may be: recovered shapes, free space, weights, tables, refusals."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from grasp_refine.core.errors import MeshError
from grasp_refine.geometry.shapes import EMBEDDED
from grasp_refine.scans.completion import complete
from grasp_refine.scans.hypothesis import Hypothesis
from grasp_refine.scans.scan import Scan
from grasp_refine.scans.space import Space
from seen import seen

NOISE_M = 0.001
CORNER = (1.0, 1.3, 0.8)


def inside(hypothesis: Hypothesis, points: np.ndarray) -> np.ndarray:
    """Mask (N,) of the points in a solid."""
    result = np.zeros(len(points), dtype=bool)
    for piece in hypothesis.pieces:
        normals, offsets = piece.planes
        result |= (points @ normals.T <= offsets).all(axis=1)
    return result


def overlap(hypothesis: Hypothesis, mesh: trimesh.Trimesh) -> float:
    """Volume of the intersection over the volume of the union with a mesh."""
    low, high = mesh.bounds
    pad = 0.2 * (high - low).max()
    points = np.random.default_rng(0).uniform(low - pad, high + pad, (20_000, 3))
    mine, true = inside(hypothesis, points), mesh.contains(points)
    return float((mine & true).sum() / (mine | true).sum())


def l_shape() -> trimesh.Trimesh:
    """Two arms of 6 cm, 2 cm thick."""
    arms = [trimesh.creation.box(bounds=[[0, 0, 0], high]) for high in ((0.06, 0.02, 0.03), (0.02, 0.06, 0.03))]
    return trimesh.boolean.union(arms)


SHAPES = {
    "box": lambda: trimesh.creation.box([0.04, 0.06, 0.05]),
    "cylinder": lambda: trimesh.creation.cylinder(0.03, 0.09, sections=48),
    "l": l_shape,
    "bowl": EMBEDDED["bowl"],
}


@pytest.fixture(scope="module")
def found() -> dict[str, tuple[trimesh.Trimesh, Scan, tuple[Hypothesis, ...]]]:
    """Meshes, their scans from one corner, and what these may be."""
    result = {}
    for name, make in SHAPES.items():
        mesh = make()
        scan = seen(mesh, CORNER, noise_m=NOISE_M)
        result[name] = mesh, scan, complete(scan)
    return result


@pytest.mark.parametrize(("name", "least"), [("box", 0.8), ("cylinder", 0.85), ("l", 0.6)])
def test_one_of_the_solids_is_the_object(found, name: str, least: float) -> None:
    mesh, _, hypotheses = found[name]
    assert max(overlap(one, mesh) for one in hypotheses) > least


@pytest.mark.parametrize("name", SHAPES)
def test_weights_are_probabilities_the_largest_after_the_first(found, name: str) -> None:
    weights = [one.weight for one in found[name][2]]
    assert 1 < len(weights) <= 8 and sum(weights) == pytest.approx(1.0)
    assert weights[1:] == sorted(weights[1:], reverse=True) and min(weights) > 0


@pytest.mark.parametrize("name", SHAPES)
def test_no_solid_enters_free_space(found, name: str) -> None:
    _, scan, hypotheses = found[name]
    space = Space(scan)
    for one in hypotheses:
        low, high = np.min([p.bounds[0] for p in one.pieces], 0), np.max([p.bounds[1] for p in one.pieces], 0)
        points = np.random.default_rng(0).uniform(low, high, (4000, 3))
        depth = space.free_depth(points[inside(one, points)])
        limit = space.margin + 3 * NOISE_M + 0.03 * np.linalg.norm(high - low)
        assert (depth > limit).mean() < 0.1, one.kind


@pytest.mark.parametrize("name", SHAPES)
def test_the_far_side_lies_within_the_spread(found, name: str) -> None:
    mesh, scan, hypotheses = found[name]
    way = -np.array(CORNER) / np.linalg.norm(CORNER)
    far = (mesh.vertices @ way).max()
    ends = [max((piece.vertices @ way).max() for piece in one.pieces) for one in hypotheses]
    assert min(ends) - 3 * NOISE_M < far < max(ends) + 3 * NOISE_M


def test_the_inside_of_a_bowl_stays_free(found) -> None:
    _, _, hypotheses = found["bowl"]
    middle = np.array([[0.0, 0.0, 0.03], [0.0, 0.0, 0.045], [0.02, 0.0, 0.04]])
    weight = sum(one.weight for one in hypotheses if inside(one, middle).any())
    assert weight < 0.2


def test_a_revolved_bowl_keeps_its_inside_free_where_it_was_not_seen(found) -> None:
    _, _, hypotheses = found["bowl"]
    revolved = [one for one in hypotheses if one.kind == "revolved"]
    angle = np.linspace(0, 2 * np.pi, 12, endpoint=False)[:, None]
    hollow = np.hstack([0.03 * np.cos(angle), 0.03 * np.sin(angle), np.full_like(angle, 0.035)])
    assert revolved and inside(revolved[0], hollow).mean() < 0.1


def test_same_seed_same_solids(found) -> None:
    _, scan, hypotheses = found["cylinder"]
    again = complete(scan)
    assert [one.weight for one in again] == [one.weight for one in hypotheses]
    for one, other in zip(again, hypotheses, strict=True):
        for piece, same in zip(one.pieces, other.pieces, strict=True):
            np.testing.assert_array_equal(piece.vertices, same.vertices)


def test_solids_move_with_the_scan(found) -> None:
    mesh, scan, _ = found["cylinder"]
    T = trimesh.transformations.rotation_matrix(0.7, [1, 2, 3], [0.1, 0.2, -0.1])
    moved = replace(
        scan,
        points=trimesh.transform_points(scan.points, T),
        normals=scan.normals @ T[:3, :3].T,
        origins=trimesh.transform_points(scan.origins, T),
    )
    assert max(overlap(one, mesh.copy().apply_transform(T)) for one in complete(moved)) > 0.85


def test_more_views_leave_less_open(found) -> None:
    mesh = SHAPES["box"]()
    around = complete(seen(mesh, CORNER, (-1.0, -1.3, -0.8), noise_m=NOISE_M))
    assert overlap(around[0], mesh) > 0.85
    assert sum(one.weight * overlap(one, mesh) for one in around) > 0.8


def test_nothing_lies_below_the_table() -> None:
    mesh = SHAPES["cylinder"]()
    table = np.array([0.0, 0.0, -0.045]), np.array([0.0, 0.0, 1.0])
    hypotheses = complete(seen(mesh, CORNER, noise_m=NOISE_M), table=table)
    assert min(piece.vertices[:, 2].min() for one in hypotheses for piece in one.pieces) >= -0.045 - 1e-9
    assert max(overlap(one, mesh) for one in hypotheses) > 0.85


def test_a_single_face_is_completed_to_boxes_of_several_depths() -> None:
    """Without noise all points lie in one plane."""
    hypotheses = complete(seen(SHAPES["box"](), (0, 0, 1)))
    assert sum(one.weight for one in hypotheses) == pytest.approx(1.0)
    ends = [min(piece.vertices[:, 2].min() for piece in one.pieces) for one in hypotheses]
    assert min(ends) < 0.0 and 0.015 < max(ends) < 0.025


def test_a_table_is_where_the_object_ends() -> None:
    """A scan knows its table; without one, the far side may lie anywhere."""
    mesh = SHAPES["box"]()
    scan = seen(mesh, (0.1, 0, 1), noise_m=NOISE_M)
    table = np.array([0.1, 0.0, -0.025]), np.array([0.0, 0.0, 1.0])
    weights, lowest, alike = {}, {}, {}
    for name, found in (("open", complete(scan)), ("table", complete(replace(scan, table=table)))):
        weights[name] = np.array([one.weight for one in found])
        lowest[name] = np.array([min(piece.vertices[:, 2].min() for piece in one.pieces) for one in found])
        alike[name] = weights[name] @ [overlap(one, mesh) for one in found]
    assert weights["table"][np.abs(lowest["table"] + 0.025) < 0.004].sum() > 0.9
    assert weights["open"][np.abs(lowest["open"] + 0.025) < 0.004].sum() < 0.5
    assert alike["table"] > alike["open"] + 0.05


def test_scans_without_a_sensor_are_completed(found) -> None:
    _, scan, _ = found["box"]
    blind = replace(scan, origins=np.zeros((0, 3)), view=np.zeros(len(scan.points), int))
    assert sum(one.weight for one in complete(blind)) == pytest.approx(1.0)


@pytest.mark.parametrize(
    "fault", ["few", "line", "not finite", "not unit", "plane without a sensor", "count", "below the table"]
)
def test_scans_of_which_no_solid_can_be_made_are_refused(fault: str) -> None:
    scan = seen(SHAPES["box"](), (0, 0, 1))
    if fault == "few":
        scan = replace(scan, points=scan.points[:5], normals=scan.normals[:5], view=scan.view[:5])
    elif fault == "line":
        scan = replace(scan, points=scan.points * [1, 0, 0])
    elif fault == "not finite":
        scan = replace(scan, points=np.where(scan.points == scan.points[3], np.nan, scan.points))
    elif fault == "not unit":
        scan = replace(scan, normals=2 * scan.normals)
    elif fault == "plane without a sensor":
        scan = replace(scan, origins=np.zeros((0, 3)))
    with pytest.raises(MeshError):
        table = np.array([0, 0, 0.1 if fault == "below the table" else -0.1]), np.array([0, 0, 1.0])
        complete(scan, count=0 if fault == "count" else 8, table=table)
