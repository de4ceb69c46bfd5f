"""Collision geometry of links: primitives, hulls of meshes with scales, and where mesh files are found."""

from pathlib import Path

import numpy as np
import pytest
import trimesh

from grasp_refine.description.link_geometry import link_pieces, resolve_mesh
from grasp_refine.description.urdf import read_urdf
from grasp_refine.errors import HandError
from grasp_refine.geometry.pieces import Piece

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
    path = package / "urdf/hand.urdf"
    collisions = "".join(f"<collision>{origin}<geometry>{g}</geometry></collision>" for g in geometries)
    path.write_text(f'<robot name="r"><link name="tip">{collisions}</link></robot>')
    return link_pieces(read_urdf(path).links[0], path, {})


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


def test_a_file_that_is_used_twice_is_read_once(package: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from grasp_refine.description import link_geometry

    read = []
    load_mesh = link_geometry.load_mesh
    monkeypatch.setattr(link_geometry, "load_mesh", lambda path: read.append(path) or load_mesh(path))
    names = ["../meshes/wedge.stl", "package://my_hand/meshes/wedge.stl"]
    assert len(pieces(package, *(f'<mesh filename="{name}" scale="{s}"/>' for s in (1, 2) for name in names))) == 2
    assert len(read) == 2, "once per spelling of its path"


@pytest.mark.parametrize(
    "filename",
    [
        "../meshes/wedge.stl",
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


def test_a_file_address_may_be_percent_encoded(package: Path) -> None:
    (package / "meshes/wedge.stl").rename(package / "meshes/a wedge.stl")
    assert resolve_mesh(f"file://{package}/meshes/a%20wedge.stl", package / "urdf/hand.urdf").is_file()


def test_the_package_of_that_name_wins_over_a_folder_nearby(package: Path) -> None:
    nearby, named = package / "urdf/meshes/wedge.stl", package / "urdf/my_hand/meshes/wedge.stl"
    for file in (nearby, named):
        file.parent.mkdir(parents=True)
        file.touch()
    assert resolve_mesh("package://my_hand/meshes/wedge.stl", package / "urdf/hand.urdf") == named


@pytest.mark.parametrize(
    ("geometry", "message"),
    [
        ('<mesh filename="none.stl"/>', r"mesh 'none.stl' not found: tried .*/my_hand/urdf/none.stl$"),
        (
            '<mesh filename="package://p/none.stl"/>',
            r"not found: tried p/none.stl and none.stl in .*/my_hand/urdf and",
        ),
        (
            '<mesh filename="http://a.b/c.stl"/>',
            r"mesh 'http://a.b/c.stl': only paths, file:// and package:// are read",
        ),
        ('<mesh filename="hand.urdf"/>', r"hand.urdf: .*'.urdf'.* .obj, .stl"),
        ('<mesh filename="broken.dae"/>', r"broken.dae: cannot be read as a mesh"),
        ('<mesh filename="../meshes/wedge.stl" scale="1 1 0"/>', r"wedge.stl x \[1. 1. 0.\]: flat"),
        ('<box size="0 1 1"/>', r"box: side lengths must be positive and finite, got \[0.0, 1.0, 1.0\]"),
        ('<box size="1 1 1e-9"/>', r"box: flat"),
        ('<sphere radius="0"/>', r"sphere: radius must be positive"),
        ('<cylinder radius="1" length="-1"/>', r"cylinder: radius and length must be positive"),
    ],
)
def test_geometry_that_cannot_be_used_names_the_link(package: Path, geometry: str, message: str) -> None:
    (package / "urdf/broken.dae").write_text("broken")
    with pytest.raises(HandError, match=f"hand.urdf: link 'tip': .*{message}") as caught:
        pieces(package, geometry)
    assert "\n" not in str(caught.value)
