"""Collision geometry of links: primitives, meshes with scales as hulls or several pieces, and what is said of these."""

import zipfile
from pathlib import Path

import numpy as np
import pytest
import trimesh

from grasp_refine.core.errors import HandError, MeshError
from grasp_refine.geometry.pieces import Piece
from grasp_refine.hands.files.link_geometry import LinkMeshes, link_pieces
from grasp_refine.hands.files.mesh_files import read_mesh, resolve_mesh
from grasp_refine.hands.files.urdf_tree import urdf_tree
from refusals import assert_names, refused

WEDGE = np.array([[0, 0, 0], [1, 0, 0], [0, 2, 0], [0, 0, 3.0]])


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """A ROS-like package NAME/meshes, NAME/urdf; returns its folder."""
    for folder in ("my_hand/meshes", "my_hand/urdf"):
        (tmp_path / folder).mkdir(parents=True)
    wedge = trimesh.Trimesh(WEDGE, [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    for suffix in ("stl", "obj", "dae"):
        wedge.export(tmp_path / f"my_hand/meshes/wedge.{suffix}")
    return tmp_path / "my_hand"


def pieces(package: Path, *geometries: str, origin: str = "") -> tuple[Piece, ...]:
    return cut(package, *geometries, origin=origin)[0]


def cut(package: Path, *geometries: str, origin: str = "", limit: float = 5e-3) -> tuple[tuple[Piece, ...], list[str]]:
    """The pieces of a link with these collision elements, and what is said about them."""
    path = package / "urdf/hand.urdf"
    collisions = "".join(f"<collision>{origin}<geometry>{g}</geometry></collision>" for g in geometries)
    path.write_text(f'<robot name="r"><link name="tip">{collisions}</link></robot>')
    meshes = LinkMeshes(path, limit)
    return link_pieces(next(iter(urdf_tree(path).links.values())), meshes), meshes.notes()


def volume(piece: Piece) -> float:
    return float(piece.mesh().volume)


def same_points(a: np.ndarray, b: np.ndarray) -> bool:
    return np.allclose(a[np.lexsort(np.round(a, 6).T)], b[np.lexsort(np.round(b, 6).T)], atol=1e-6)


def test_primitives_stand_at_their_origin(package: Path) -> None:
    shapes = ['<box size="1 2 3"/>', '<cylinder radius="1" length="4"/>', '<sphere radius="0.5"/>']
    box, cylinder, sphere = pieces(package, *shapes, origin='<origin xyz="1 2 3" rpy="1.5707963267948966 0 0"/>')
    np.testing.assert_allclose(box.bounds, [[0.5, 0.5, 2], [1.5, 3.5, 4]])
    np.testing.assert_allclose(cylinder.bounds, [[0, 0, 2], [2, 4, 4]], atol=1e-12)
    np.testing.assert_allclose(sphere.vertices, [[1, 2, 3]])
    assert sphere.radius == 0.5


@pytest.mark.parametrize("suffix", ["stl", "obj", "dae"])
def test_a_mesh_becomes_its_hull(package: Path, suffix: str) -> None:
    (piece,) = pieces(package, f'<mesh filename="../meshes/wedge.{suffix}"/>')
    assert same_points(piece.vertices, WEDGE)


def test_the_unit_of_a_collada_file_counts(package: Path) -> None:
    file = package / "meshes/wedge.dae"
    text = file.read_text()
    millimetres = text.replace("<up_axis>", '<unit name="millimeter" meter="0.001"/><up_axis>')
    assert millimetres != text
    file.write_text(millimetres)
    (piece,) = pieces(package, '<mesh filename="../meshes/wedge.dae"/>')
    assert same_points(piece.vertices, WEDGE / 1000)


@pytest.mark.parametrize("scale", ["0.001", "0.001 0.002 0.003", "-1 1 1", "1 -2 -3", "-1 -1 -1"])
def test_scales_stretch_and_mirror_a_mesh_and_faces_still_look_outward(package: Path, scale: str) -> None:
    (piece,) = pieces(package, f'<mesh filename="../meshes/wedge.stl" scale="{scale}"/>')
    factors = np.broadcast_to([float(word) for word in scale.split()], 3)
    assert same_points(piece.vertices, WEDGE * factors)
    assert volume(piece) == pytest.approx(abs(factors.prod()), rel=1e-6)


def test_several_collisions_of_one_link_are_several_pieces_and_repeated_ones_count_once(
    package: Path,
) -> None:
    shapes = ['<box size="1 1 1"/>', '<sphere radius="1"/>', '<sphere radius="2"/>', '<box size="1 1 1"/>']
    assert [len(piece.vertices) for piece in pieces(package, *shapes)] == [8, 1, 1]


@pytest.fixture
def palm(package: Path) -> Path:
    """The package, with meshes of two cubes of 20 mm that are 30 mm apart along x, in metres and in millimetres."""
    cubes = [trimesh.creation.box([0.02] * 3), trimesh.creation.box([0.02] * 3)]
    cubes[1].apply_translation([0.05, 0, 0])
    both = trimesh.util.concatenate(cubes)
    for suffix in ("obj", "dae"):
        both.export(package / f"meshes/palm.{suffix}")
    both.apply_scale(1000).export(package / "meshes/palm_mm.stl")
    return package


@pytest.mark.parametrize(
    "mesh",
    [
        'palm.obj"',
        'palm.dae"',
        'palm_mm.stl" scale="0.001"',
        'palm.obj" scale="-1 1 1"',
        'palm_mm.stl" scale="-0.001 0.001 -0.001"',
    ],
)
def test_bodies_apart_are_a_piece_each_whatever_the_file_and_scale(palm: Path, mesh: str) -> None:
    found, notes = cut(palm, f'<mesh filename="../meshes/{mesh}/>')
    side = -1 if "-" in mesh else 1
    assert sorted(side * piece.bounds.mean(axis=0)[0] for piece in found) == pytest.approx([0, 0.05], abs=1e-8)
    assert [volume(piece) for piece in found] == pytest.approx([8e-6] * 2, rel=1e-6)
    # The hull is farthest from both cubes in the middle between them.
    (note,) = notes
    assert_names(note, "tip", mesh.split(chr(34))[0], "15.0 mm", "2 convex", "2.0 mm")


def test_a_hull_within_the_limit_stays_and_is_noted_if_it_stands_out_noticeably(palm: Path) -> None:
    (piece,), notes = cut(palm, '<mesh filename="../meshes/palm.obj"/>', limit=0.02)
    assert volume(piece) == pytest.approx(0.07 * 0.02 * 0.02)
    (note,) = notes
    assert_names(note, "tip", "palm.obj", "15.0 mm", "20.0 mm")


def test_a_mesh_of_several_links_is_cut_and_mentioned_once(palm: Path) -> None:
    path = palm / "urdf/hand.urdf"
    collision = '<collision><geometry><mesh filename="../meshes/palm.obj"/></geometry></collision>'
    links = "".join(f'<link name="{name}">{collision * 2}</link>' for name in ("left", "right"))
    joint = '<joint name="j" type="fixed"><parent link="left"/><child link="right"/></joint>'
    path.write_text(f'<robot name="r">{links}{joint}</robot>')
    meshes = LinkMeshes(path)
    left, right = (link_pieces(link, meshes) for link in urdf_tree(path).links.values())
    assert len(left) == 2, "the repeated element counts once"
    assert [a is b for a, b in zip(left, right, strict=True)] == [True, True]
    (note,) = meshes.notes()
    assert_names(note, "left, right", "palm.obj")


@pytest.mark.parametrize(
    "filename",
    [
        "../meshes/wedge.stl",
        "meshes/wedge.stl",
        "package://my_hand/meshes/wedge.stl",
        "package://other_name/meshes/wedge.stl",
        "{folder}/meshes/wedge.stl",
        "file://{folder}/meshes/wedge.stl",
        "file://../meshes/wedge.stl",
    ],
)
def test_mesh_addresses(package: Path, filename: str) -> None:
    found = resolve_mesh(filename.format(folder=package), package / "urdf/hand.urdf")
    assert found.samefile(package / "meshes/wedge.stl")


@pytest.mark.parametrize(
    ("geometry", "named"),
    [
        ('<mesh filename="none.stl"/>', ("'none.stl'", "/my_hand/urdf/none.stl", "/my_hand/none.stl")),
        ('<mesh filename="package://p/none.stl"/>', ("p/none.stl", " none.stl", "/my_hand/urdf ")),
        ('<mesh filename="http://a.b/c.stl"/>', ("'http://a.b/c.stl'", "file://", "package://")),
        ('<mesh filename="hand.urdf"/>', ("'.urdf'", ".obj, .stl")),
        ('<mesh filename="broken.dae"/>', ("broken.dae",)),
        ('<mesh filename="../meshes/wedge.stl" scale="1 1 0"/>', ("wedge.stl", "[1. 1. 0.]", "flat")),
        (f'<mesh filename="{"a" * 300}.stl"/>', ("a.stl'",)),
        (f'<mesh filename="{"a/" * 1500}b.stl"/>', ("b.stl'",)),
        ('<sphere radius="1e-300"/>', ("sphere", "1e-300 m")),
        ('<mesh filename="../meshes/wedge.stl" scale="1e200 1e200 1e308"/>', ("1 of", "4 vertices", "finite")),
        ('<box size="0 1 1"/>', ("box", "[0.0, 1.0, 1.0]")),
        ('<box size="1 1 1e-9"/>', ("box", "flat")),
        ('<sphere radius="0"/>', ("sphere", "radius", "0")),
        ('<cylinder radius="1" length="-1"/>', ("cylinder", "radius", "length", "-1")),
    ],
)
def test_geometry_that_cannot_be_used_names_the_link(package: Path, geometry: str, named: tuple[str, ...]) -> None:
    (package / "urdf/broken.dae").write_text("broken")
    with refused(HandError, "hand.urdf", "'tip'", *named):
        pieces(package, geometry)


def test_a_flat_mesh_does_not_collide(package: Path) -> None:
    """A sticker with a marker is no reason to refuse a hand."""
    trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]]).export(
        package / "meshes/marker.stl"
    )
    made, (note,) = cut(package, '<mesh filename="../meshes/marker.stl"/>', '<box size="1 1 1"/>')
    assert len(made) == 1 and "marker.stl" in note and "tip" in note


def test_missing_meshes_are_found_before_any_is_cut(package: Path) -> None:
    path = package / "urdf/hand.urdf"
    names = ("../meshes/wedge.stl", "one.stl", "two.stl", "one.stl")
    collisions = (f'<collision><geometry><mesh filename="{name}"/></geometry></collision>' for name in names)
    path.write_text(f'<robot name="r"><link name="tip">{"".join(collisions)}</link></robot>')
    with refused(HandError, "'tip'", "one.stl", "1 other mesh is missing"):
        LinkMeshes(path).require(urdf_tree(path).links.values())


def test_a_zip_is_not_unpacked_as_a_mesh(tmp_path: Path) -> None:
    """Readers of Collada unpack one, however much is in it."""
    path = tmp_path / "bomb.dae"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("bomb.dae", b" " * 2**20)
    with refused(MeshError, "bomb.dae", "zip"):
        read_mesh(path)
