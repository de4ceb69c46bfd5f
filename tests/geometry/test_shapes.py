"""Embedded objects and primitives: closed, hand sized, and the same each time."""

import numpy as np
import pytest

from grasp_refine.core.errors import MeshError
from grasp_refine.geometry.body import build_body
from grasp_refine.geometry.mesh import check_mesh, is_convex, watertight
from grasp_refine.geometry.pieces import convex_pieces
from grasp_refine.geometry.shapes import EMBEDDED, primitive, primitive_pieces
from refusals import refused

SIZES = {
    "mug": [0.1025, 0.08, 0.09],
    "bottle": [0.06, 0.06, 0.18],
    "rounded_box": [0.06, 0.05, 0.09],
    "bowl": [0.13, 0.13, 0.05],
}


@pytest.mark.parametrize("name", EMBEDDED)
def test_embedded_objects_are_closed_and_hand_sized(name):
    mesh = EMBEDDED[name]()
    check_mesh(mesh, name)
    closed, notes = watertight(mesh, name)
    assert closed is mesh and notes == ()
    assert mesh.is_volume and mesh.body_count == 1
    assert 300 <= len(mesh.faces) <= 3000
    np.testing.assert_allclose(mesh.extents, SIZES[name], atol=5e-5)
    assert is_convex(mesh) == (name == "rounded_box")


@pytest.mark.parametrize("name", EMBEDDED)
def test_embedded_objects_are_the_same_each_time(name):
    one, other = EMBEDDED[name](), EMBEDDED[name]()
    np.testing.assert_array_equal(one.vertices, other.vertices)
    np.testing.assert_array_equal(one.faces, other.faces)


def test_volumes_follow_from_the_drawings():
    prism = 28 / 2 * np.sin(2 * np.pi / 28)
    cup = prism * (0.04**2 * 0.09 - 0.036**2 * 0.086)
    handle = EMBEDDED["mug"]().volume - cup
    assert 1e-6 < handle < 8e-6
    # Steiner's formula for the rounded box, from outside the tessellation.
    core, r = np.array([0.048, 0.038, 0.078]), 0.006
    faces = 2 * (core[0] * core[1] + core[1] * core[2] + core[2] * core[0])
    exact = core.prod() + faces * r + np.pi * core.sum() * r**2 + 4 / 3 * np.pi * r**3
    assert EMBEDDED["rounded_box"]().volume == pytest.approx(exact, rel=2e-3)


def test_the_mug_is_hollow_and_its_handle_is_open():
    mesh = EMBEDDED["mug"]()
    points = [
        [0, 0, 0.05],
        [0, 0, 0.002],
        [0.038, 0, 0.02],
        [0.05, 0, 0.046],
        [0.06, 0, 0.046],
        [0, 0.05, 0.046],
    ]
    assert winding(mesh, np.array(points)).round().astype(int).tolist() == [0, 1, 1, 0, 1, 0]


def winding(mesh, points):
    """Generalised winding number (N,): 1 inside, 0 outside (van Oosterom and Strackee)."""
    a, b, c = np.moveaxis(mesh.triangles[None] - points[:, None, None], 2, 0)
    la, lb, lc = (np.linalg.norm(v, axis=2) for v in (a, b, c))
    dot = (np.einsum("pfi,pfi->pf", *pair) for pair in ((a, b), (b, c), (c, a)))
    ab, bc, ca = dot
    triple = np.einsum("pfi,pfi->pf", a, np.cross(b, c))
    return np.arctan2(triple, la * lb * lc + ab * lc + bc * la + ca * lb).sum(1) / (2 * np.pi)


@pytest.mark.parametrize(("name", "most"), [("bottle", 4), ("mug", 25)])
def test_concave_objects_come_apart_into_few_pieces(name, most):
    mesh = EMBEDDED[name]()
    pieces = convex_pieces(mesh, name=name)
    assert 2 <= len(pieces) <= most
    assert mesh.volume < sum(piece.mesh().volume for piece in pieces) < 1.25 * mesh.volume
    body = build_body(name, pieces)
    assert body.area == pytest.approx(mesh.area, rel=0.1)
    assert body.diagonal == pytest.approx(np.linalg.norm(mesh.extents), rel=0.02)
    ahead = winding(mesh, body.candidates.points + 2e-3 * body.candidates.normals)
    assert (ahead < 0.5).mean() > 0.98


def test_primitives_are_exact():
    (piece,) = primitive_pieces("sphere:0.03")
    assert piece.radius == 0.03 and piece.vertices.tolist() == [[0, 0, 0]]
    (piece,) = primitive_pieces("box:0.06,0.05,0.09")
    np.testing.assert_allclose(piece.bounds, [[-0.03, -0.025, -0.045], [0.03, 0.025, 0.045]])
    (piece,) = primitive_pieces("cylinder:0.03,0.1")
    np.testing.assert_allclose(piece.bounds, [[-0.03, -0.03, -0.05], [0.03, 0.03, 0.05]])


@pytest.mark.parametrize(
    ("spec", "volume"),
    [
        ("box:0.06,0.05,0.09", 0.06 * 0.05 * 0.09),
        ("sphere:0.03", 4 / 3 * np.pi * 0.03**3),
        ("cylinder:0.03,0.1", np.pi * 0.03**2 * 0.1),
    ],
)
def test_primitive_meshes_are_closed(spec, volume):
    mesh = primitive(spec)
    assert mesh.is_volume and is_convex(mesh)
    assert mesh.volume == pytest.approx(volume, rel=0.02)


@pytest.mark.parametrize("spec", ["box", "box:1,2", "box:a,b,c", "sphere:", "sphere:1,2", "cone:1,2", "", "box:1,2,3,"])
def test_other_forms_are_refused_with_the_valid_ones(spec):
    with refused(MeshError, "box:x,y,z", "sphere:r", "cylinder:r,h"):
        primitive_pieces(spec)


@pytest.mark.parametrize("spec", ["box:1,0,1", "sphere:-1", "cylinder:nan,1", "sphere:inf"])
def test_sizes_that_make_no_solid_are_refused(spec):
    shape, _, sizes = spec.partition(":")
    with refused(MeshError, shape, min(map(float, sizes.split(",")))):
        primitive(spec)
