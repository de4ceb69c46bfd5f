"""Objects from names, primitives and files; which mesh in a folder a name means."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
import trimesh

from grasp_refine.errors import AssetError, MeshError
from grasp_refine.geometry.pieces import Decomposition
from grasp_refine.geometry.shapes import EMBEDDED
from grasp_refine.objects import find_object, load_object


@pytest.fixture
def cache(tmp_path: Path) -> Path:
    return tmp_path / "cache"


@pytest.fixture
def cube(tmp_path: Path) -> Path:
    path = tmp_path / "cube.obj"
    trimesh.creation.box(extents=(2, 2, 2)).export(path)
    return path


@pytest.mark.parametrize("name", ["box:0.1,0.2,0.3", "cylinder:0.03,0.1", "sphere:0.04"])
def test_primitives_are_one_exact_piece(name: str):
    thing = load_object(name, candidates=64)
    assert thing.name == name
    assert thing.convex and thing.notes == ()
    assert len(thing.body.pieces) == 1
    assert len(thing.body.candidates.points) == 64
    assert thing.mesh.is_watertight


def test_a_sphere_is_a_point_with_a_radius():
    (piece,) = load_object("sphere:0.04", scale=2.0, candidates=64).body.pieces
    assert piece.vertices.tolist() == [[0, 0, 0]]
    assert piece.radius == 0.08


def test_the_scale_takes_everything_along(cube: Path, cache: Path):
    for source, size in ((cube, 2.0), ("box:2,2,2", 2.0)):
        thing = load_object(source, scale=0.03, candidates=64, cache=cache)
        np.testing.assert_allclose(thing.mesh.extents, 0.03 * size)
        np.testing.assert_allclose(thing.body.diagonal, 0.03 * size * np.sqrt(3))
        np.testing.assert_allclose(np.abs(thing.body.candidates.points).max(), 0.03 * size / 2)


def test_a_convex_mesh_is_its_hull_and_needs_no_decomposition(cube: Path, cache: Path):
    lines: list[str] = []
    thing = load_object(cube, scale=0.03, candidates=64, cache=cache, progress=lines.append)
    assert thing.name == "cube"
    assert thing.convex
    assert len(thing.body.pieces) == 1
    assert lines == []
    assert not cache.exists()


@pytest.fixture
def corner(tmp_path: Path) -> Path:
    """Two boxes in the shape of an L: concave, and quickly decomposed."""
    path = tmp_path / "corner.ply"
    arm = trimesh.creation.box(bounds=[[0, 0, 0], [3, 1, 1]])
    leg = trimesh.creation.box(bounds=[[0, 0, 0], [1, 3, 1]])
    trimesh.boolean.union([arm, leg]).export(path)
    return path


def test_a_concave_mesh_is_decomposed_once_for_all_scales(corner: Path, cache: Path):
    lines: list[str] = []
    first = load_object(corner, candidates=64, cache=cache, progress=lines.append)
    assert not first.convex
    assert len(first.body.pieces) == 2
    assert len(lines) == 2 and lines[0].startswith("decomposing corner (")
    again = load_object(corner, candidates=64, cache=cache, progress=lines.append)
    assert len(lines) == 2
    for one, other in zip(first.body.pieces, again.body.pieces, strict=True):
        np.testing.assert_array_equal(one.vertices, other.vertices)
    small = load_object(corner, scale=0.02, candidates=64, cache=cache, progress=lines.append)
    assert len(lines) == 2
    np.testing.assert_allclose(small.body.diagonal, 0.02 * first.body.diagonal)


def test_the_users_cache_is_used_unless_another_is_named(corner: Path, tmp_path: Path, monkeypatch):
    monkeypatch.setenv("GRASP_REFINE_CACHE", str(tmp_path / "user"))
    load_object(corner, candidates=64, cache=None)
    assert not (tmp_path / "user").exists()
    load_object(corner, candidates=64)
    assert len(list((tmp_path / "user" / "pieces").iterdir())) == 1


def test_decomposition_settings_reach_coacd(corner: Path):
    coarse = Decomposition(threshold=1.0)
    assert len(load_object(corner, candidates=64, cache=None, decomposition=coarse).body.pieces) == 1


@pytest.mark.parametrize("name", EMBEDDED)
def test_embedded_objects_load(name: str):
    thing = load_object(name, candidates=64, cache=None, decomposition=Decomposition(threshold=1.0))
    assert thing.name == name
    assert thing.mesh.is_watertight
    assert 0.05 < thing.body.diagonal < 0.3
    assert thing.convex == (name == "rounded_box")


def test_same_seed_same_candidates():
    points = [load_object("box:1,1,1", candidates=64, seed=s).body.candidates.points for s in (1, 1, 2)]
    np.testing.assert_array_equal(points[0], points[1])
    assert not np.array_equal(points[0], points[2])


def test_repairs_are_noted(tmp_path: Path, cache: Path):
    mesh = trimesh.creation.box(extents=(2, 2, 2))
    mesh.invert()
    mesh.export(tmp_path / "inverted.stl")
    thing = load_object(tmp_path / "inverted.stl", candidates=64, cache=cache)
    assert thing.mesh.volume > 0
    assert len(thing.notes) == 1 and "inside out" in thing.notes[0]


def test_an_embedded_name_wins_over_a_file_only_without_a_suffix(tmp_path: Path, monkeypatch, cache: Path):
    monkeypatch.chdir(tmp_path)
    trimesh.creation.box(extents=(2, 2, 2)).export("bowl.obj")
    assert load_object("bowl.obj", candidates=64, cache=cache).convex


@pytest.mark.parametrize(
    ("source", "scale", "error", "message"),
    [
        (
            "teapot",
            1.0,
            AssetError,
            f"no object 'teapot': embedded ones are {', '.join(EMBEDDED)}; "
            "primitives are box:x,y,z, sphere:r, cylinder:r,h (metres); "
            "or give a mesh file (.obj, .stl, .ply, .glb, .off)",
        ),
        ("teapot.obj", 1.0, MeshError, "teapot.obj: no such mesh file"),
        (Path("teapot"), 1.0, MeshError, "teapot: "),
        ("teapot.step", 1.0, MeshError, "teapot.step: "),
        ("folder/teapot", 1.0, MeshError, "folder/teapot: "),
        ("cone:1,2", 1.0, MeshError, "'cone:1,2' is not a primitive: use box:x,y,z"),
        ("mug", 0.0, MeshError, "mug: the scale must be positive and finite, got 0"),
        ("sphere:1", float("nan"), MeshError, "sphere:1: the scale must be positive and finite, got nan"),
    ],
)
def test_what_there_is_not(source: str | Path, scale: float, error: type, message: str):
    with pytest.raises(error, match=f"^{re.escape(message)}"):
        load_object(source, scale=scale)


def test_an_open_mesh_is_refused_by_name(tmp_path: Path):
    mesh = trimesh.creation.icosphere(subdivisions=3)
    mesh.update_faces(mesh.triangles_center[:, 2] < 0.3)
    mesh.export(tmp_path / "open.ply")
    with pytest.raises(MeshError, match="^open: not watertight"):
        load_object(tmp_path / "open.ply")


def test_a_shared_object_loads(shared_assets: Path):
    path = shared_assets / "objects" / "ycb_005_tomato_soup_can.obj"
    # One coarse piece: the threshold of the defaults takes CoACD minutes here.
    thing = load_object(path, candidates=64, cache=None, decomposition=Decomposition(threshold=1.0))
    assert thing.name == "ycb_005_tomato_soup_can"
    assert 0.1 < thing.body.diagonal < 0.2


# -- finding ---------------------------------------------------------------------------------------------


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    folder = tmp_path / "objects"
    folder.mkdir()
    meshes = ("ycb_011_banana.obj", "banana_peel.obj", "red-mug.STL", "blue_mug.obj", "Cup.ply")
    for name in (*meshes, "notes_mug.txt"):
        (folder / name).touch()
    return folder


@pytest.mark.parametrize(
    ("name", "file"),
    [
        ("ycb_011_banana", "ycb_011_banana.obj"),
        ("011_banana", "ycb_011_banana.obj"),
        ("011-Banana", "ycb_011_banana.obj"),
        ("banana", "ycb_011_banana.obj"),
        ("redmug", "red-mug.STL"),
        ("CUP", "Cup.ply"),
    ],
)
def test_a_name_is_the_end_of_a_stem(folder: Path, name: str, file: str):
    assert find_object(name, folder) == folder / file


def test_the_exact_stem_wins(folder: Path):
    (folder / "mug.obj").touch()
    assert find_object("mug", folder) == folder / "mug.obj"
    (folder / "m-u-g.obj").touch()
    assert find_object("mug", folder) == folder / "mug.obj"


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("mug", "object 'mug' could be any of blue_mug.obj, red-mug.STL in {folder}"),
        (
            "pear",
            "no mesh of object 'pear' in {folder}; "
            "there are Cup.ply, banana_peel.obj, blue_mug.obj, red-mug.STL, ycb_011_banana.obj",
        ),
        (
            "_",
            "no mesh of object '_' in {folder}; "
            "there are Cup.ply, banana_peel.obj, blue_mug.obj, red-mug.STL, ycb_011_banana.obj",
        ),
    ],
)
def test_none_or_several(folder: Path, name: str, message: str):
    with pytest.raises(AssetError, match=f"^{re.escape(message.format(folder=folder))}$"):
        find_object(name, folder)


def test_a_folder_that_is_missing_or_empty(tmp_path: Path):
    with pytest.raises(AssetError, match="none: no such folder of objects$"):
        find_object("mug", tmp_path / "none")
    with pytest.raises(AssetError, match=r"there are no meshes \(\.obj, \.stl, \.ply, \.glb, \.off\)$"):
        find_object("mug", tmp_path)


def test_finds_the_objects_of_the_shared_grasps(shared_assets: Path):
    for path in sorted((shared_assets / "grasps" / "normalised").glob("*.npz")):
        with np.load(path) as grasps:
            names = set(grasps["object"].tolist()) - {"cube_75mm"}
        for name in names:
            assert find_object(name, shared_assets / "objects").is_file()
