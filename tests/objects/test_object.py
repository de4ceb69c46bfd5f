"""Objects from names, primitives, files and folders of pieces; which mesh or folder in a folder a name means."""

import re
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh

from grasp_refine.core.errors import AssetError, MeshError
from grasp_refine.geometry import pieces
from grasp_refine.geometry.pieces import Decomposition
from grasp_refine.geometry.shapes import EMBEDDED
from grasp_refine.objects import object
from grasp_refine.objects.folders import find_object
from refusals import assert_names, refused

load_object = partial(object.load_object, unit="m")  # most bodies of these tests are metres large


def without_top(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    mesh.update_faces(mesh.triangles_center[:, 2] < mesh.bounds[1, 2] - 1e-6)
    return mesh


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


def test_the_scale_takes_everything_along(cube: Path, cache: Path):
    for source, size in ((cube, 2.0), ("box:2,2,2", 2.0)):
        thing = load_object(source, scale=0.03, candidates=64, cache=cache)
        np.testing.assert_allclose(thing.mesh.extents, 0.03 * size)
        np.testing.assert_allclose(thing.body.diagonal, 0.03 * size * np.sqrt(3))
        np.testing.assert_allclose(np.abs(thing.body.candidates.points).max(), 0.03 * size / 2)
    (piece,) = load_object("sphere:0.04", scale=2.0, candidates=64).body.pieces
    assert piece.vertices.tolist() == [[0, 0, 0]] and piece.radius == 0.08


def test_a_convex_mesh_is_its_hull_and_needs_no_decomposition(cube: Path, cache: Path):
    lines: list[str] = []
    thing = load_object(cube, scale=0.03, candidates=64, cache=cache)
    object.prepare([thing], progress=lines.append)
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


def test_a_mesh_in_memory_is_the_object_of_its_file(corner: Path, cache: Path):
    """A trimesh, or vertices and faces, were refused."""
    from_file = object.load_object(corner, scale=0.05, cache=cache)
    mesh = trimesh.load_mesh(corner)
    vertices, faces = mesh.vertices.tolist(), torch.as_tensor(np.array(mesh.faces))
    for source in (mesh, (vertices, faces)):
        found = object.load_object(source, name="corner", scale=0.05, cache=cache)
        assert found.name == "corner" and found.file is None
        np.testing.assert_allclose(found.mesh.bounds, from_file.mesh.bounds, atol=1e-12)
        assert found.mesh.volume == pytest.approx(from_file.mesh.volume)
        assert len(found.body.pieces) == len(from_file.body.pieces) > 1
    assert object.load_object(mesh, scale=0.05, cache=str(cache)).name == "object"
    np.testing.assert_array_equal(mesh.vertices, vertices)


@pytest.mark.parametrize(
    ("source", "named"),
    [
        ((np.zeros((4, 3)),), ("mine", "vertices", "faces", "got 1")),
        ((np.eye(3), [[0, 1, 3]]), ("mine", "faces", "3 vertices")),
        ((np.eye(3), [[0, 1]]), ("mine", "faces", "(F, 3)", "(1, 2)")),
        ((np.zeros((4, 2)), [[0, 1, 2]]), ("mine", "vertices", "(V, 3)", "(4, 2)")),
        (trimesh.creation.box((100.0, 90.0, 80.0)), ("mine", "mm")),
        (trimesh.Trimesh(np.eye(3), [[0, 1, 2]]), ("mine", "4 points")),
    ],
)
def test_a_mesh_in_memory_is_checked_as_a_file(source, named: tuple[str, ...]):
    with refused(MeshError, *named):
        object.load_object(source, name="mine")


def test_a_concave_mesh_is_decomposed_once_for_all_scales(corner: Path, cache: Path):
    lines: list[str] = []
    first = load_object(corner, candidates=64, cache=cache)
    object.prepare([first], progress=lines.append)
    assert not first.convex
    assert len(first.body.pieces) == 2
    assert len(lines) == 2 and "corner" in lines[0]
    again = load_object(corner, candidates=64, cache=cache)
    object.prepare([again], progress=lines.append)
    assert len(lines) == 2
    for one, other in zip(first.body.pieces, again.body.pieces, strict=True):
        np.testing.assert_array_equal(one.vertices, other.vertices)
    small = load_object(corner, scale=0.02, candidates=64, cache=cache)
    object.prepare([small], progress=lines.append)
    assert len(lines) == 2
    np.testing.assert_allclose(small.body.diagonal, 0.02 * first.body.diagonal)


def test_the_users_cache_is_used_unless_another_is_named(corner: Path, tmp_path: Path, monkeypatch):
    monkeypatch.setenv("GRASP_REFINE_CACHE", str(tmp_path / "user"))
    object.prepare([load_object(corner, candidates=64, cache=None)])
    assert not (tmp_path / "user").exists()
    object.prepare([load_object(corner, candidates=64)])
    assert len(list((tmp_path / "user" / "pieces").iterdir())) == 1


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


@pytest.mark.parametrize("source", ["box:90,60,40", "file"])
def test_a_file_in_millimetres_is_asked_about_and_read_with_its_unit(source: str, tmp_path: Path, cache: Path):
    trimesh.creation.box(extents=(90, 60, 40)).export(tmp_path / "brick.stl")
    source = tmp_path / "brick.stl" if source == "file" else source
    with refused(MeshError, "90 x 60 x 40 m ", "`unit='mm'`", "90 x 60 x 40 mm"):
        object.load_object(source, candidates=64, cache=cache)
    thing = load_object(source, unit="mm", candidates=64, cache=cache)
    np.testing.assert_allclose(thing.mesh.extents, [0.09, 0.06, 0.04])
    np.testing.assert_allclose(thing.body.pieces[0].bounds[1], [0.045, 0.03, 0.02])
    # Whoever says metres, or a scale, is believed.
    assert load_object(source, unit="m", candidates=64, cache=cache).body.diagonal > 100
    assert load_object(source, scale=0.002, unit=None, candidates=64, cache=cache).body.diagonal < 0.3


def test_convex_bodies_in_one_file_are_the_pieces(tmp_path: Path, cache: Path):
    bars = [trimesh.creation.box(bounds=bounds) for bounds in ([[0, 0, 0], [3, 1, 1]], [[0, 0.5, 0.5], [1, 3, 1.5]])]
    for suffix in ("obj", "glb"):
        trimesh.Scene(bars).export(tmp_path / f"cross.{suffix}")
        thing = load_object(tmp_path / f"cross.{suffix}", candidates=64, cache=cache)
        assert sorted(piece.mesh().volume for piece in thing.body.pieces) == pytest.approx([2.5, 3])
        assert not thing.convex
    assert not cache.exists()


def test_a_cavity_is_no_piece(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Both surfaces are convex, yet they are cut as one body: as pieces of their own the cavity would be solid."""
    cut: list[np.ndarray] = []
    monkeypatch.setattr(pieces, "decompose", lambda vertices, *_, **__: cut.append(vertices) or [vertices])
    shell = trimesh.creation.box(extents=(2, 2, 2))
    cavity = trimesh.creation.box(extents=(1, 1, 1))
    cavity.invert()
    trimesh.util.concatenate([shell, cavity]).export(tmp_path / "hollow.obj")
    object.prepare([load_object(tmp_path / "hollow.obj", candidates=64, cache=None)])
    assert [len(vertices) for vertices in cut] == [16]


def test_holes_are_closed_as_asked(tmp_path: Path, cache: Path):
    mesh = trimesh.creation.cylinder(0.03, 0.1, sections=24)
    mesh.update_faces(mesh.face_normals[:, 2] < 0.9)
    mesh.export(tmp_path / "pot.stl")
    with refused(MeshError, "pot", "24 edges", "`holes='cap'`", "`holes='hull'`"):
        load_object(tmp_path / "pot.stl", candidates=64, cache=cache)
    volume = trimesh.creation.cylinder(0.03, 0.1, sections=24).volume
    for holes, size in (("cap", "84.9 mm"), ("hull", "24 edges")):
        thing = load_object(tmp_path / "pot.stl", holes=holes, candidates=64, cache=cache)
        assert_names(thing.notes[-1], size)
        assert thing.mesh.is_volume and thing.mesh.volume == pytest.approx(volume)


@pytest.mark.parametrize(
    ("source", "scale", "error", "named"),
    [
        (
            "teapot",
            1.0,
            AssetError,
            ("'teapot'", ", ".join(EMBEDDED), "box:x,y,z, sphere:r, cylinder:r,h", ".obj, .stl, .ply, .glb, .off"),
        ),
        ("teapot.obj", 1.0, MeshError, ("teapot.obj",)),
        (Path("teapot"), 1.0, MeshError, ("teapot",)),
        ("teapot.step", 1.0, MeshError, ("teapot.step",)),
        ("folder/teapot", 1.0, MeshError, ("folder/teapot",)),
        ("", 1.0, AssetError, ("''",)),
        ("cone:1,2", 1.0, MeshError, ("'cone:1,2'", "box:x,y,z")),
        ("mug", 0.0, MeshError, ("mug", "scale", "positive", "0")),
        ("sphere:1", float("nan"), MeshError, ("sphere:1", "scale", "finite", "nan")),
    ],
)
def test_what_there_is_not(source: str | Path, scale: float, error: type, named: tuple[str, ...]):
    with refused(error, *named):
        load_object(source, scale=scale)


ARM, LEG = ([0, 0, 0], [3, 1, 1]), ([0, 1, 0], [1, 3, 1])
"""Two boxes in the shape of an L that share a face."""


def put(path: Path, *meshes: trimesh.Trimesh) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    trimesh.util.concatenate(list(meshes)).export(path)
    return path


def block(bounds) -> trimesh.Trimesh:
    return trimesh.creation.box(bounds=bounds)


SHEET = trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]], [[0, 1, 2], [2, 1, 3]], process=False)
TRIANGLE = trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]], process=False)
SPECK = trimesh.Trimesh(np.ones((4, 3)), [[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]], process=False)


@pytest.fixture
def parts(tmp_path: Path) -> Path:
    """The meshes of a folder are the pieces of an L."""
    # They are written in another order than that of their names.
    put(tmp_path / "el" / "b.STL", block(LEG))
    put(tmp_path / "el" / "a.obj", block(ARM))
    (tmp_path / "el" / "notes.txt").write_text("no mesh")
    return tmp_path / "el"


@pytest.fixture
def bodex(tmp_path: Path) -> Path:
    """An L as DexGraspBench and BODex lay out an object."""
    folder = tmp_path / "el_0"
    put(folder / "urdf" / "meshes" / "convex_piece_001.obj", block(LEG))
    put(folder / "urdf" / "meshes" / "convex_piece_000.obj", block(ARM))
    (folder / "urdf" / "coacd.urdf").write_text("<robot/>")
    trimesh.boolean.union([block(ARM), block(LEG)]).export(put(folder / "mesh" / "simplified.obj", block(ARM)))
    return folder


def corners(pieces) -> list[list[list[float]]]:
    return [piece.bounds.tolist() for piece in pieces]


@pytest.fixture
def dexgraspnet(tmp_path: Path) -> Path:
    """An L as DexGraspNet lays out an object: both pieces, which touch, in one file."""
    folder = tmp_path / "core-el-0"
    groups, count = [], 1
    for name, bounds in (("convex_10", LEG), ("convex_9", ARM)):
        mesh = block(bounds)
        groups += [f"o {name}", *(f"v {x} {y} {z}" for x, y, z in mesh.vertices)]
        groups += [f"f {a} {b} {c}" for a, b, c in mesh.faces + count]
        count += len(mesh.vertices)
    (folder / "coacd").mkdir(parents=True)
    (folder / "coacd" / "decomposed.obj").write_text("\n".join(groups))
    return folder


@pytest.mark.parametrize("layout", ["parts", "bodex", "dexgraspnet"])
def test_the_meshes_of_a_folder_are_the_pieces(layout: str, request: pytest.FixtureRequest, cache: Path):
    folder = request.getfixturevalue(layout)
    lines: list[str] = []
    thing = load_object(folder, candidates=64, cache=cache)
    object.prepare([thing], progress=lines.append)
    assert thing.name == folder.name
    assert corners(thing.body.pieces) == [[list(map(float, corner)) for corner in box] for box in (ARM, LEG)]
    assert not thing.convex and thing.notes == ()
    assert thing.mesh.volume == pytest.approx(5)
    # Nothing was decomposed.
    assert lines == [] and not list(cache.glob("*.npz"))
    small = load_object(folder, scale=0.02, candidates=64, cache=cache)
    np.testing.assert_allclose(corners(small.body.pieces), 0.02 * np.array([ARM, LEG]), atol=1e-12)
    np.testing.assert_allclose(small.mesh.extents, [0.06, 0.06, 0.02])


def test_the_distance_of_given_pieces_from_their_surface_is_said(bodex: Path, cache: Path):
    """The leg of the L ends 0.3 beyond its surface, in a folder of 3 m."""
    put(bodex / "urdf" / "meshes" / "convex_piece_001.obj", block(([0, 1, 0], [1, 3.3, 1])))
    for _ in range(2):
        (note,) = load_object(bodex, candidates=64, cache=cache, scale=0.01).notes
        assert_names(note, "2 convex pieces", "3.00 mm", "surface")
    assert len(list((cache / "distances").glob("*.npz"))) == 1


def test_an_embedded_name_is_no_folder_unless_it_comes_as_a_path(parts: Path, monkeypatch):
    monkeypatch.chdir(parts.parent)
    parts.rename("rounded_box")
    assert load_object("rounded_box", candidates=64).convex
    for source in ("./rounded_box", Path("rounded_box")):
        assert len(load_object(source, candidates=64).body.pieces) == 2


def check_only_note(thing: object.Object, *named: str) -> None:
    (note,) = thing.notes
    assert_names(note, *named)


def check_surface_note(thing: object.Object, *named: str) -> None:
    """Of pieces with another surface, the second note is the distance between both."""
    note, distance = thing.notes
    assert_names(note, *named)
    assert_names(distance, "convex piece", " mm ")


def test_an_open_surface_changes_nothing_that_is_touched(bodex: Path):
    whole = load_object(bodex, candidates=64)
    torn = trimesh.boolean.union([block(ARM), block(LEG)]).subdivide()
    put(bodex / "mesh" / "simplified.obj", without_top(torn))
    thing = load_object(bodex, candidates=64)
    check_surface_note(thing, "simplified.obj", "watertight")
    assert not thing.mesh.is_watertight
    assert corners(thing.body.pieces) == corners(whole.body.pieces)
    np.testing.assert_array_equal(thing.body.candidates.points, whole.body.candidates.points)


def test_a_piece_that_is_not_convex_is_noted(parts: Path):
    # The hull of the L has the area of the square without the corner: 9 - 0.5 * 2 / 2 = 8.5, against 8.
    put(parts / "c.obj", trimesh.boolean.union([block(([0, 0, 0], [3, 2.5, 1])), block(([0, 2, 0], [1, 3, 1]))]))
    thing = load_object(parts, candidates=64)
    check_only_note(thing, "c.obj", "hull", "6.2%")
    assert thing.body.pieces[2].mesh().volume == pytest.approx(8.5)


def test_a_folder_with_a_mesh_of_the_whole_object_has_no_convex_pieces(parts: Path, bodex: Path):
    """As of YCB: its hull would fill all hollows. Where a layout says that meshes are pieces, they are."""
    whole = trimesh.boolean.union([block(ARM), block(LEG)])
    put(parts / "textured.obj", whole)
    with refused(MeshError, parts, "textured.obj has 40.0%", "a.obj, b.STL, textured.obj"):
        load_object(parts, candidates=64)
    put(bodex / "urdf" / "meshes" / "convex_piece_002.obj", whole)
    assert "40.0%" in load_object(bodex, candidates=64).notes[0]


@pytest.mark.parametrize("flat", [SHEET, TRIANGLE, SPECK], ids=["sheet", "triangle", "speck"])
def test_flat_pieces_are_dropped_and_noted(parts: Path, flat: trimesh.Trimesh):
    put(parts / "aa.obj", flat)
    thing = load_object(parts, candidates=64)
    check_only_note(thing, "aa.obj", "flat")
    assert len(thing.body.pieces) == 2


def test_a_folder_without_a_usable_piece_is_refused(tmp_path: Path):
    folder = tmp_path / "paper"
    put(folder / "a.obj", SHEET)
    put(folder / "b.obj", TRIANGLE)
    with refused(MeshError, folder, "flat", "a.obj, b.obj"):
        load_object(folder)


def test_a_folder_without_meshes_is_refused(tmp_path: Path):
    with refused(MeshError, tmp_path, "urdf/meshes", ".obj, .stl, .ply, .glb, .off", "coacd/decomposed.obj"):
        load_object(tmp_path)


@pytest.mark.parametrize("text", ["", "v 0 0 nan\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 2 4\n"])
def test_a_broken_piece_is_refused_not_left_out(parts: Path, text: str):
    (parts / "c.obj").write_text(text)
    with refused(MeshError, parts / "c.obj"):
        load_object(parts)


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
        ("11banana", None),
        ("nana", None),
        ("redmug", "red-mug.STL"),
        ("CUP", "Cup.ply"),
    ],
)
def test_a_name_is_the_end_of_a_stem_from_a_word_on(folder: Path, name: str, file: str | None):
    if file is None:
        with refused(AssetError, f"'{name}'"):
            find_object(name, folder)
    else:
        assert find_object(name, folder) == folder / file


@pytest.mark.parametrize(
    ("name", "listed"),
    [
        ("mug", " blue_mug.obj, red-mug.STL"),
        ("pear", " Cup.ply, banana_peel.obj, blue_mug.obj, red-mug.STL, ycb_011_banana.obj"),
        ("_", " Cup.ply, banana_peel.obj, blue_mug.obj, red-mug.STL, ycb_011_banana.obj"),
    ],
)
def test_none_or_several(folder: Path, name: str, listed: str):
    with refused(AssetError, f"'{name}'", folder, listed) as caught:
        find_object(name, folder)
    assert len(re.findall(r"\.(?:obj|STL|ply)\b", str(caught.value))) == len(listed.split(", "))


def test_finds_the_objects_of_the_shared_grasps(shared_assets: Path):
    for path in sorted((shared_assets / "grasps" / "normalised").glob("*.npz")):
        with np.load(path) as grasps:
            names = set(grasps["object"].tolist()) - {"cube_75mm"}
        for name in names:
            assert find_object(name, shared_assets / "objects").is_file()


@pytest.fixture
def mixed(folder: Path) -> Path:
    """Meshes, and folders with and without pieces."""
    for path in (
        "core_bottle_5f/urdf/meshes/p0.obj",
        "sem-Car-1/p0.STL",
        "old_Cup/p0.obj",
        "textures_banana/skin.png",
        "empty_peel/urdf/meshes/readme.txt",
        "peach.v2/p0.obj",
    ):
        (folder / path).parent.mkdir(parents=True)
        (folder / path).touch()
    return folder


@pytest.mark.parametrize(
    ("name", "file"),
    [
        ("core_bottle_5f", "core_bottle_5f"),
        ("Core-Bottle-5F", "core_bottle_5f"),
        ("5f", "core_bottle_5f"),
        ("car_1", "sem-Car-1"),
        ("peach.v2", "peach.v2"),
        # Plainly equal goes before the end of another one.
        ("cup", "Cup.ply"),
        ("old_cup", "old_Cup"),
        # Folders without pieces are no objects.
        ("banana", "ycb_011_banana.obj"),
        ("peel", "banana_peel.obj"),
    ],
)
def test_folders_of_pieces_are_found_like_meshes(mixed: Path, name: str, file: str):
    assert find_object(name, mixed) == mixed / file


@pytest.mark.parametrize("name", ["Cup", "cup", "CUP"])
def test_a_folder_of_pieces_wins_over_a_mesh_of_the_same_name(mixed: Path, name: str):
    (mixed / "Cup").mkdir()
    assert find_object(name, mixed) == mixed / "Cup.ply"
    (mixed / "Cup" / "p0.obj").touch()
    assert find_object(name, mixed) == mixed / "Cup"
    (mixed / "Cup.obj").touch()
    assert find_object(name, mixed) == mixed / "Cup"


def test_a_mesh_and_a_folder_of_other_names_that_fit_alike_are_ambiguous(mixed: Path):
    (mixed / "cu-p").mkdir()
    (mixed / "cu-p" / "p0.obj").touch()
    with refused(AssetError, "'cup'", " Cup.ply, cu-p/ ", mixed):
        find_object("cup", mixed)
    # The one of exactly that name is meant all the same.
    assert find_object("Cup", mixed) == mixed / "Cup.ply"
    (mixed / "green_mug").mkdir()
    (mixed / "green_mug" / "p0.obj").touch()
    with refused(AssetError, "'mug'", " blue_mug.obj, green_mug/, red-mug.STL ", mixed):
        find_object("mug", mixed)


def test_a_name_that_is_too_long_for_a_file_is_no_folder():
    with refused(MeshError, "a" * 20):
        load_object("a" * 300 + ".obj")
    with refused(AssetError, "'aaa"):
        load_object("a" * 300)


@pytest.mark.parametrize(
    ("name", "size"),
    [
        ("sphere:1e-60", "1e-60 m"),
        ("sphere:1e60", "1e+60 m"),
        ("box:1e-60,1e-60,1e-60", "1.73205e-60 m"),
        ("cylinder:1e60,1", "2.82843e+60 m"),
    ],
)
def test_primitives_of_no_size_are_refused(name: str, size: str):
    with refused(MeshError, name.partition(":")[0], size):
        load_object(name)
