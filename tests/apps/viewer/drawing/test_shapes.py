"""What hands and objects look like, and where the links are."""

from pathlib import Path

import numpy as np
import pytest
import trimesh

from grasp_refine.hands.hand import Hand, load_hand
from grasp_refine.objects.object import load_object
from grasp_refine_apps.viewer.drawing.shapes import (
    CONTACT_COLOR,
    LINK_COLOR,
    OBJECT_COLOR,
    URDF_COLOR_SHARE,
    LinkPoses,
    Shape,
    collision_shapes,
    decimate,
    object_shapes,
    visual_shapes,
)

URDF = """<robot name="r">
  <link name="base"><visual><geometry><box size="0.1 0.1 0.02"/></geometry></visual></link>
  <link name="finger">
    <visual><geometry><mesh filename="none.stl"/></geometry></visual>
    <collision><geometry><sphere radius="0.03"/></geometry></collision>
  </link>
  <link name="tip">
    <visual><origin xyz="0 0 0.1"/><geometry><box size="0.02 0.02 0.02"/></geometry>
      <material name="black"><color rgba="0 0 0 1"/></material></visual>
    <visual><geometry><mesh filename="other.obj"/></geometry></visual>
    <collision><geometry><box size="0.04 0.04 0.04"/></geometry></collision>
  </link>
  <link name="nail"><visual><geometry><box size="0.01 0.01 0.01"/></geometry>
    <material name="black"/></visual></link>
  <link name="frame"/>
  <joint name="a" type="revolute"><parent link="base"/><child link="finger"/><axis xyz="1 0 0"/>
    <limit lower="-1" upper="1"/></joint>
  <joint name="b" type="revolute"><parent link="finger"/><child link="tip"/><origin xyz="0 0 0.05"/>
    <axis xyz="1 0 0"/><limit lower="-1" upper="1"/></joint>
  <joint name="c" type="fixed"><parent link="tip"/><child link="nail"/><origin xyz="0 0.01 0"/></joint>
  <joint name="d" type="fixed"><parent link="tip"/><child link="frame"/></joint>
</robot>"""
"""Links that only show something, that only collide readably, that do both, and neither."""


@pytest.fixture
def hand(tmp_path: Path) -> Hand:
    (tmp_path / "hand.urdf").write_text(URDF)
    return load_hand(tmp_path / "hand.urdf", candidates=16)


def by_link(shapes: tuple[Shape, ...]) -> dict[str, Shape]:
    assert len({shape.link for shape in shapes}) == len(shapes)
    return {shape.link: shape for shape in shapes}


def volume(vertices: np.ndarray, faces: np.ndarray) -> float:
    """Signed volume, positive where the faces look outward."""
    a, b, c = np.moveaxis(vertices.astype(float)[faces], 1, 0)
    return float(np.einsum("fi,fi->", a, np.cross(b, c)) / 6)


def test_links_look_as_their_urdf_says_or_else_as_what_collides(hand: Hand):
    said: list[str] = []
    shapes = by_link(visual_shapes(hand, said.append))
    assert list(shapes) == ["base", "finger", "tip", "nail"]
    assert volume(shapes["base"].vertices, shapes["base"].faces) == pytest.approx(0.1 * 0.1 * 0.02)
    assert volume(shapes["finger"].vertices, shapes["finger"].faces) == pytest.approx(4 / 3 * np.pi * 0.03**3, rel=0.02)
    # One of two can be read.
    np.testing.assert_allclose(shapes["tip"].vertices.max(axis=0), [0.01, 0.01, 0.11], atol=1e-7)
    assert [line.partition(": ")[0] for line in said] == ["link 'finger'", "link 'tip'"]
    assert "none.stl" in said[0] and "other.obj" in said[1]


def test_collision_shapes_are_what_collides(hand: Hand):
    shapes = by_link(collision_shapes(hand))
    assert list(shapes) == ["finger", "tip"]
    assert volume(shapes["tip"].vertices, shapes["tip"].faces) == pytest.approx(0.04**3)


def test_contact_links_have_a_colour_of_their_own_and_black_is_lightened(hand: Hand):
    assert [contact.link for contact in hand.contacts] == ["tip"]
    colors = {link: shape.color for link, shape in by_link(visual_shapes(hand)).items()}
    half = tuple(round((1 - URDF_COLOR_SHARE) * channel) for channel in LINK_COLOR)
    assert colors == {"base": LINK_COLOR, "finger": LINK_COLOR, "tip": CONTACT_COLOR, "nail": half}
    assert {shape.color for shape in collision_shapes(hand)} == {LINK_COLOR, CONTACT_COLOR}


def test_a_urdf_that_is_gone_leaves_what_collides(hand: Hand):
    hand.urdf.unlink()
    said: list[str] = []
    assert [shape.link for shape in visual_shapes(hand, said.append)] == ["finger", "tip"]
    assert len(said) == 1 and "hand.urdf: cannot be read" in said[0]


def test_sharp_edges_have_vertices_of_their_own():
    (box,) = object_shapes(load_object("box:0.1,0.2,0.3", candidates=16), "mesh")
    assert box.vertices.shape == (24, 3) and box.faces.shape == (12, 3)  # 3 at each corner
    (ball,) = object_shapes(load_object("sphere:0.1", candidates=16), "mesh")
    assert len(ball.vertices) == 2 + len(ball.faces) // 2  # Euler: each vertex once


def test_an_object_is_its_surface_or_its_pieces():
    mug = load_object("mug", candidates=16)
    whole, pieces = object_shapes(mug, "mesh")[0], object_shapes(mug, "pieces")
    assert whole.color == OBJECT_COLOR
    assert volume(whole.vertices, whole.faces) == pytest.approx(mug.mesh.volume, rel=1e-5)
    assert len(pieces) == len(mug.body.pieces) > 5
    assert len({piece.color for piece in pieces[:8]}) == 8
    for shown, piece in zip(pieces, mug.body.pieces, strict=True):
        assert volume(shown.vertices, shown.faces) == pytest.approx(piece.mesh().volume, rel=1e-4)


def test_links_that_only_show_something_have_poses(hand: Hand):
    poses = LinkPoses.of(hand)(np.eye(4), np.array([np.pi / 6, np.pi / 6]))
    # 5 cm up, turned by 30 degrees about x, then 1 cm along y turned by 60 degrees.
    expected = [0.0, -0.05 * 0.5 + 0.01 * 0.5, 0.05 * np.sqrt(0.75) + 0.01 * np.sqrt(0.75)]
    np.testing.assert_allclose(poses["nail"][:3, 3], expected, atol=1e-12)


@pytest.mark.parametrize("most", [200, 2000, 5000])
def test_a_ball_keeps_its_shape(most: int):
    mesh = trimesh.creation.icosphere(subdivisions=5, radius=0.05)
    small = decimate(mesh, most)
    assert most / 3 < len(small.faces) <= most
    # The mean of a patch lies no deeper in the ball than the middle of its longest chord.
    off = 0.05 - np.linalg.norm(small.vertices, axis=1)
    assert -1e-9 < off.min() and off.max() < small.edges_unique_length.max() ** 2 / (8 * 0.05)
    outward = np.einsum("fi,fi->f", small.face_normals, small.triangles_center) > 0
    assert outward.mean() > 0.98
    assert small.volume > 0.8 * mesh.volume
