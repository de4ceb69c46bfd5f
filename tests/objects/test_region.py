"""Regions of objects: signed distances in closed form, their gradients, and specifications right and wrong."""

from pathlib import Path

import numpy as np
import pytest
import trimesh

from grasp_refine.core.errors import GraspRefineError
from grasp_refine.objects.object import Object, load_object
from grasp_refine.objects.region import Box, ContactRegions, Faces, HalfSpace, Region
from grasp_refine.objects.region_spec import contact_regions, resolve_spec, spec_digest
from refusals import refused

LOW, HIGH = np.array([-0.02, -0.01, 0.0]), np.array([0.03, 0.02, 0.05])

H = 1e-7
"""Step of finite differences in metres."""


@pytest.fixture(scope="module")
def cube() -> Object:
    """A cube of 6 cm about the origin."""
    return load_object("box:0.06,0.06,0.06")


def top(side: float = 0.03) -> Faces:
    """The upper face of a cube of half this side."""
    mesh = trimesh.creation.box(extents=[2 * side] * 3)
    return Faces("top", np.asarray(mesh.triangles), mesh.face_normals[:, 2] > 0.5)


def on_cube(seed: int, count: int = 200, side: float = 0.03) -> np.ndarray:
    """Random points (N, 3) on a cube."""
    points = np.random.default_rng(seed).uniform(-side, side, (count, 3))
    axis = np.abs(points).argmax(axis=1)[:, None]
    np.put_along_axis(points, axis, side * np.sign(np.take_along_axis(points, axis, 1)), 1)
    return points


def assert_gradient(region: Region | ContactRegions, points: np.ndarray, rough: int = 0) -> None:
    """The gradient is that of finite differences; at up to `rough` points another part is nearest within the step."""
    _, found = region.signed_distance(points)
    ends = [region.signed_distance(points[:, None] + sign * H * np.eye(3))[0] for sign in (1.0, -1.0)]
    error = np.abs(found - (ends[0] - ends[1]) / (2 * H)).max(axis=1)
    assert np.sort(error)[-1 - rough] < 1e-4, np.sort(error)[-3:]


def test_the_distance_of_a_box_is_that_of_its_nearest_point() -> None:
    points = np.random.default_rng(0).uniform(-0.08, 0.1, (400, 3))
    found, _ = Box("box", LOW, HIGH).signed_distance(points)
    outside = np.linalg.norm(points - np.clip(points, LOW, HIGH), axis=1)
    depth = np.minimum(points - LOW, HIGH - points).min(axis=1)
    assert (depth > 0).any()
    np.testing.assert_allclose(found, np.where(depth > 0, -depth, outside), atol=1e-15)
    assert_gradient(Box("box", LOW, HIGH), points)


def test_a_plane_has_the_side_that_its_normal_points_to(cube: Object) -> None:
    regions = contact_regions(cube, "plane:0,0,0.01,0,3,4")
    assert regions is not None
    found, gradient = regions.signed_distance(np.array([[0.0, 0.0, 0.02], [0.5, 0.0, 0.0]]))
    np.testing.assert_allclose(found, [-0.008, 0.008], atol=1e-15)
    np.testing.assert_allclose(gradient, np.tile([0.0, -0.6, -0.8], (2, 1)), atol=1e-15)
    above, below = (contact_regions(cube, f"{kind}:x=0.01") for kind in ("above", "below"))
    assert above is not None and below is not None
    np.testing.assert_allclose(above.signed_distance(LOW[None])[0], 0.03, atol=1e-15)
    np.testing.assert_allclose(below.signed_distance(LOW[None])[0], -0.03, atol=1e-15)


def test_the_distance_of_faces_is_that_of_their_border_through_space() -> None:
    region, points = top(), on_cube(1)
    found, _ = region.signed_distance(points)
    inside = points[:, 2] == 0.03
    border = 0.03 - np.abs(points[:, :2]).max(axis=1)
    away = np.linalg.norm(points - np.clip(points, [-0.03, -0.03, 0.03], 0.03), axis=1)
    assert inside.sum() > 20
    # Far away the nearest of the cut triangles may be missed by half an edge of one.
    np.testing.assert_allclose(found[inside], -border[inside], atol=5e-5)
    np.testing.assert_allclose(found[~inside], away[~inside], atol=5e-5)
    off = points * np.random.default_rng(2).uniform(0.97, 1.03, (len(points), 1))
    assert_gradient(region, off, rough=10)


def test_all_of_a_mesh_is_inside_everywhere() -> None:
    region = Faces("all", top().triangles, np.ones(12, dtype=bool))
    distance, gradient = region.signed_distance(on_cube(3))
    assert (distance == -np.inf).all() and np.isfinite(gradient).all()


def test_any_wanted_region_will_do_and_none_to_avoid() -> None:
    wanted, unwanted = (top(), Box("box", LOW, HIGH)), (HalfSpace("half", np.array([0.6, 0.0, 0.8]), 0.018),)
    regions, points = ContactRegions(wanted, unwanted), on_cube(4)
    each = [region.signed_distance(points)[0] for region in (*wanted, *unwanted)]
    np.testing.assert_array_equal(
        regions.signed_distance(points)[0], np.maximum(np.minimum(each[0], each[1]), -each[2])
    )
    np.testing.assert_array_equal(regions.miss(points), np.maximum(regions.signed_distance(points)[0], 0.0))
    assert_gradient(regions, points + 1e-5 * np.random.default_rng(5).normal(size=points.shape), rough=10)
    assert "half" in regions.reason(np.array([0.03, 0.0, 0.03])) and "avoid" in regions.reason(np.full(3, 0.03))
    assert "10.0 mm outside of top and box" in regions.reason(np.array([-0.03, 0.0, 0.0]))


@pytest.mark.parametrize(
    ("spec", "named"),
    [
        ("bix:0,0,0,1,1,1", ["bix", "did you mean box", "above:z=0.05"]),
        ("box:0,0,0,1,1", ["6 numbers", "0,0,0,1,1"]),
        ("box:0,0,0,1,1,0", ["second corner", "in z"]),
        ("box:40,-20,0,80,20,90", ["none of the surface", "x -0.03 to 0.03", "metres"]),
        ("above:0.02", ["above:z=0.05"]),
        ("above:z=nan", ["1 number", "nan"]),
        ("plane:0,0,0,0,0,0", ["normal"]),
        ("plane:0,0,0,1e300,0,1e300", ["normal"]),
        ("color:red", ["#ff0000", "red"]),
        ("color:#ff0000", ["no colours", "faces:FILE"]),
        ("faces:missing.txt", ["missing.txt", "no such file"]),
        ("faces:", ["not complete"]),
    ],
)
def test_regions_that_cannot_be_used_are_refused(cube: Object, spec: str, named: list[str]) -> None:
    with refused(GraspRefineError, "avoid", *named):
        contact_regions(cube, avoid=spec)


def test_nothing_left_to_touch_is_refused(cube: Object) -> None:
    with refused(GraspRefineError, "touch above:z=0.01", "avoid above:z=0"):
        contact_regions(cube, "above:z=0.01", ["above:z=0"])
    assert contact_regions(cube) is None


@pytest.mark.parametrize("content", ["3, 4\n11", "3 4 11\n"])
def test_faces_are_numbered_as_in_their_file_before_any_repair(tmp_path: Path, content: str) -> None:
    # The first triangle is flat and is dropped when the mesh is loaded; materials take turns, in millimetres.
    mesh = trimesh.creation.box(extents=[60.0, 60.0, 60.0])
    lines = [f"v {x} {y} {z}" for x, y, z in mesh.vertices] + ["f 1 1 2"]
    for number, (a, b, c) in enumerate(mesh.faces + 1):
        lines += [f"usemtl {'even' if number % 2 else 'odd'}", f"f {a} {b} {c}"]
    path, numbers = tmp_path / "cube.obj", tmp_path / "numbers.txt"
    path.write_text("\n".join(lines))
    numbers.write_text(content)
    regions = contact_regions(load_object(path, unit="mm"), f"faces:{numbers}")
    assert regions is not None
    found = regions.miss(1e-3 * mesh.triangles_center)
    assert np.flatnonzero(found == 0.0).tolist() == [2, 3, 10] and found.max() > 0.01
    for wrong, named in (("13", ["face 13", "13 of cube"]), ("one", ["integers", "one"]), (" ", ["no numbers"])):
        numbers.write_text(wrong)
        with refused(GraspRefineError, "numbers.txt", *named):
            contact_regions(load_object(path, unit="mm"), f"faces:{numbers}")
    np.save(tmp_path / "mask.npy", np.arange(13) > 11)
    masked = contact_regions(load_object(path, unit="mm"), avoid=f"faces:{tmp_path / 'mask.npy'}")
    assert masked is not None
    assert np.flatnonzero(masked.miss(1e-3 * mesh.triangles_center)).tolist() == [11]


def test_arrays_that_are_no_numbers_of_faces_are_refused(cube: Object, tmp_path: Path) -> None:
    path = tmp_path / "faces.npy"
    for values, named in (
        (np.zeros(12, dtype=bool), "no face"),
        (np.ones(11, dtype=bool), "11 booleans for the 12 faces"),
        (np.ones((12, 2), dtype=bool), "bool"),
        (np.zeros(3), "float64"),
    ):
        np.save(path, values)
        with refused(GraspRefineError, "faces.npy", named):
            contact_regions(cube, f"faces:{path}")
    with path.open("wb") as file:
        np.savez(file, faces=np.arange(3))
    with refused(GraspRefineError, "faces.npy", "archive"):
        contact_regions(cube, f"faces:{path}")


@pytest.mark.parametrize("kind", ["face.ply", "vertex.ply", "vertex.obj", "vertex.glb"])
def test_faces_of_a_colour_have_it_at_all_corners(tmp_path: Path, kind: str) -> None:
    mesh = trimesh.creation.box(extents=[0.06, 0.06, 0.06])
    if kind.startswith("face"):
        mesh.visual.face_colors[:] = [200, 200, 200, 255]
        mesh.visual.face_colors[mesh.face_normals[:, 2] > 0.5] = [255, 0, 0, 255]
    else:
        mesh.visual.vertex_colors[:] = [200, 200, 200, 255]
        mesh.visual.vertex_colors[mesh.vertices[:, 2] > 0] = [255, 0, 0, 255]
    mesh.export(tmp_path / kind)
    obj = load_object(tmp_path / kind)
    regions = contact_regions(obj, "color:#fe0100")
    assert regions is not None
    points = on_cube(6)
    np.testing.assert_array_equal(regions.miss(points) == 0.0, points[:, 2] == 0.03)
    with refused(GraspRefineError, "#00ff00", "#ff0000 (2 faces)", "#c8c8c8"):
        contact_regions(obj, "color:#00ff00")


def test_files_of_regions_are_found_beside_their_list_and_known_by_their_contents(tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_text("1 2")
    (tmp_path / "b.txt").write_text("1 2")
    a, b = (resolve_spec(f"faces:{name}.txt", tmp_path, "list") for name in "ab")
    assert a == f"faces:{tmp_path / 'a.txt'}" and spec_digest(a) == spec_digest(b) != a
    assert resolve_spec("above:z=1", tmp_path, "list") == spec_digest("above:z=1") == "above:z=1"
