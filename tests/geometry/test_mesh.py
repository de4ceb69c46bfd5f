"""Meshes: read in every format, scaled, checked, closed or refused with a message that helps."""

import csv
import logging

import numpy as np
import pytest
import trimesh

from grasp_refine.core.errors import MeshError
from grasp_refine.geometry.mesh import FlatMeshError, check_mesh, is_convex, load_mesh, quietly, watertight
from refusals import assert_names, refused


def cube(offset=(0, 0, 0), size=(1, 1, 1)) -> trimesh.Trimesh:
    mesh = trimesh.creation.box(size)
    return mesh.apply_translation(offset)


def without(mesh: trimesh.Trimesh, *faces: int) -> trimesh.Trimesh:
    return trimesh.Trimesh(mesh.vertices, np.delete(mesh.faces, faces, axis=0), process=False)


def test_what_trimesh_logs_is_the_users_again_afterwards(monkeypatch: pytest.MonkeyPatch):
    logger = logging.getLogger("trimesh")
    monkeypatch.setattr(logger, "level", logging.DEBUG)
    with quietly():
        assert not logger.isEnabledFor(logging.CRITICAL)
    with pytest.raises(KeyError), quietly():
        raise KeyError
    assert logger.level == logging.DEBUG and logger.isEnabledFor(logging.DEBUG)


@pytest.mark.parametrize("suffix", ["obj", "stl", "ply", "glb", "off", "OBJ"])
def test_every_format_gives_the_same_solid(tmp_path, suffix):
    path = tmp_path / f"solid.{suffix}"
    cube(size=[1, 2, 3]).export(path)
    mesh = load_mesh(path, scale=0.01)
    assert len(mesh.vertices) == 8 and len(mesh.faces) == 12
    assert mesh.is_volume
    assert mesh.volume == pytest.approx(6e-6)
    np.testing.assert_allclose(mesh.extents, [0.01, 0.02, 0.03])


def test_geometries_are_joined_where_their_scene_puts_them(tmp_path):
    scene = trimesh.Scene()
    scene.add_geometry(cube(), transform=trimesh.transformations.translation_matrix([5, 0, 0]))
    scene.add_geometry(cube())
    scene.export(tmp_path / "two.glb")
    mesh = load_mesh(tmp_path / "two.glb")
    assert mesh.body_count == 2
    np.testing.assert_allclose(mesh.bounds, [[-0.5] * 3, [5.5, 0.5, 0.5]])


def test_vertices_that_texture_seams_split_are_merged(tmp_path):
    text = trimesh.exchange.obj.export_obj(cube().unmerge_vertices() or cube())
    (tmp_path / "split.obj").write_text("mtllib nowhere.mtl\nusemtl paint\n" + text)
    assert len(load_mesh(tmp_path / "split.obj").vertices) == 8


@pytest.mark.parametrize("size", [1e-7, 1e-4, 1e6])
def test_merging_does_not_depend_on_the_size(tmp_path, size):
    ball = trimesh.creation.icosphere(3).apply_scale(size)
    (tmp_path / "ball.obj").write_text(trimesh.exchange.obj.export_obj(ball, digits=20))
    mesh = load_mesh(tmp_path / "ball.obj")
    assert len(mesh.vertices) == 642 and mesh.is_watertight


def test_faces_that_merging_collapses_are_dropped(tmp_path):
    vertices = np.concatenate([cube().vertices, cube().vertices[:1]])
    faces = np.concatenate([cube().faces, [[0, 8, 1]]])
    trimesh.Trimesh(vertices, faces, process=False).export(tmp_path / "sliver.ply")
    assert load_mesh(tmp_path / "sliver.ply").is_volume


def write(path, text):
    path.write_text(text)
    return path


@pytest.mark.parametrize(
    ("name", "text", "kind", "named"),
    [
        ("a.obj", None, MeshError, ()),
        ("a.xyz", None, MeshError, ("'.xyz'", ".obj, .stl, .ply, .glb, .off")),
        ("a", None, MeshError, ("''", ".obj, .stl, .ply, .glb, .off")),
        ("a.obj", "", MeshError, ()),
        ("a.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\n", MeshError, ()),
        ("a.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", FlatMeshError, ("4 points", "(3, 3)")),
        ("a.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\nf 1 2 3\nf 2 4 3\n", FlatMeshError, ("1e-06",)),
        (
            "a.obj",
            "v 0 0 0\nv 1 0 0\nv 0 1 0\nv nan 1 1\nf 1 2 3\nf 2 4 3\n",
            MeshError,
            ("1 of its 4 vertices",),
        ),
        ("a.off", "OFF\n4 1 0\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n3 0 1 9\n", MeshError, ()),
        ("a.stl", "solid nothing\nendsolid\n", MeshError, ()),
        ("a.glb", "glTF but not really", MeshError, ()),
    ],
)
def test_files_that_hold_no_solid_are_refused(tmp_path, name, text, kind, named):
    if text is not None:
        write(tmp_path / name, text)
    with refused(kind, tmp_path / name, *named):
        load_mesh(tmp_path / name)


@pytest.mark.parametrize("scale", [0, -1, np.nan, np.inf])
def test_the_scale_must_be_positive_and_finite(tmp_path, scale):
    cube().export(tmp_path / "cube.obj")
    with refused(MeshError, tmp_path / "cube.obj", "scale", f"{scale:g}"):
        load_mesh(tmp_path / "cube.obj", scale)


def test_check_names_the_mesh_and_the_fault():
    with refused(MeshError, "thing", "faces"):
        check_mesh(trimesh.Trimesh(cube().vertices, np.zeros((0, 3), int), process=False), "thing")
    beyond = trimesh.Trimesh(cube().vertices, cube().faces, process=False)
    beyond.faces = beyond.faces + 1
    with refused(MeshError, "thing", "8"):
        check_mesh(beyond, "thing")
    with refused(FlatMeshError, "thing", "1e-06"):
        check_mesh(cube(size=[1, 1, 1e-7]), "thing")
    check_mesh(cube(size=[1, 1, 1e-5]), "thing")


def test_a_closed_mesh_is_left_alone():
    mesh = cube()
    closed, notes = watertight(mesh, "cube")
    assert closed is mesh and notes == ()


def test_an_inverted_mesh_is_turned_over():
    mesh = cube()
    mesh.invert()
    closed, (note,) = watertight(mesh, "cube")
    assert closed.volume == pytest.approx(1)
    assert mesh.volume == pytest.approx(-1)
    assert_names(note, "cube")


def test_small_holes_twisted_and_doubled_faces_are_repaired():
    twisted = cube()
    twisted.faces[3] = twisted.faces[3][::-1]
    doubled = cube()
    doubled = trimesh.Trimesh(doubled.vertices, np.concatenate([doubled.faces, doubled.faces[:1]]), process=False)
    for mesh in (without(cube(), 5), twisted, doubled):
        closed, (note,) = watertight(mesh, "cube")
        assert closed.is_volume and closed.volume == pytest.approx(1)
        assert_names(note, "cube")


def test_a_large_hole_is_refused_with_advice():
    pot = trimesh.creation.cylinder(1, 2, sections=24)
    open_pot = without(pot, *np.flatnonzero(pot.face_normals[:, 2] > 0.9))
    with refused(MeshError, "pot", "24 edges"):
        watertight(open_pot, "pot")


def test_a_sheet_folded_onto_itself_is_refused():
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]])
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    folded = trimesh.Trimesh(vertices, np.concatenate([faces, faces[:, ::-1]]), process=False)
    with refused(MeshError, "folded"):
        watertight(folded, "folded")


def test_parts_that_touch_along_an_edge_are_closed():
    mesh = trimesh.util.concatenate([cube(), cube([1, 1, 0])])
    mesh.merge_vertices()
    assert not mesh.is_watertight
    closed, notes = watertight(mesh, "two")
    assert closed.volume == pytest.approx(2) and notes == ()


def test_convex_means_one_body_that_fills_its_hull():
    assert is_convex(cube())
    assert is_convex(trimesh.creation.icosphere(3))
    assert not is_convex(trimesh.creation.annulus(0.5, 1, 1))
    assert not is_convex(trimesh.util.concatenate([cube(), cube([3, 0, 0])]))
    # Two boxes side by side fill their hull and still are two.
    assert not is_convex(trimesh.util.concatenate([cube(), cube([1, 0, 0])]))
    dented = trimesh.creation.icosphere(3)
    dented.vertices[0] *= 0.9
    assert is_convex(dented, tolerance=0.01) and not is_convex(dented, tolerance=1e-6)


def test_all_shared_objects_load_and_are_closed(shared_assets):
    with open(shared_assets / "objects.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 61
    for row in rows:
        scale = float(row["suggested_scale"])
        mesh = load_mesh(shared_assets / "objects" / f"{row['name']}.obj", scale)
        closed, notes = watertight(mesh, row["name"])
        assert notes == ()
        assert len(closed.faces) == int(row["faces"])
        assert closed.volume == pytest.approx(float(row["volume"]) * scale**3, rel=1e-4)
        assert is_convex(closed) == (float(row["convexity"]) > 0.999)


def test_a_broken_file_is_reported_once_and_without_warnings(tmp_path, capfd):
    """The reader's own words about it would stand beside ours on the screen."""
    (tmp_path / "a.stl").write_bytes(b"x" * 80 + (10**6).to_bytes(4, "little") + bytes(50))
    with refused(MeshError, tmp_path / "a.stl", "faces"):
        load_mesh(tmp_path / "a.stl")
    write(tmp_path / "b.ply", "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nend_header\n1e300\n")
    with refused(MeshError, tmp_path / "b.ply"):
        load_mesh(tmp_path / "b.ply")
    assert capfd.readouterr() == ("", "")


def test_vertices_of_no_face_do_not_count(tmp_path):
    cube().export(tmp_path / "cube.obj")
    text = (tmp_path / "cube.obj").read_text()
    far = write(tmp_path / "far.obj", f"{text}\nv 1e300 nan inf\n")
    assert load_mesh(far).volume == pytest.approx(load_mesh(tmp_path / "cube.obj").volume)


@pytest.mark.parametrize("size", [1e-12, 1e-9, 1e9])
def test_the_hull_of_an_open_mesh_does_not_depend_on_the_size(size):
    # At 1e-9 that of trimesh was a single point.
    open_cube = trimesh.Trimesh(cube().vertices * size, cube().faces[2:], process=False)
    closed, _ = watertight(open_cube, "cube", "hull")
    assert len(closed.vertices) == 8 and np.ptp(closed.vertices) == pytest.approx(np.ptp(cube().vertices) * size)


@pytest.mark.parametrize(
    ("size", "kind", "diagonal"),
    [(1e-20, FlatMeshError, "1.73205e-20 m"), (1e20, MeshError, "1.73205e+20 m"), (1e300, MeshError, "inf m")],
)
def test_sizes_that_no_solid_has(size, kind, diagonal):
    with refused(kind, "cube", diagonal):
        check_mesh(trimesh.Trimesh(cube().vertices * size, cube().faces, process=False), "cube")


def test_a_name_that_is_too_long_is_no_mesh(tmp_path):
    with refused(MeshError, f"{'a' * 300}.obj"):
        load_mesh(tmp_path / f"{'a' * 300}.obj")


def test_mending_a_sheet_says_nothing_in_the_words_of_others():
    """trimesh divides by its volume, which is none."""
    square = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]
    sheet = trimesh.Trimesh(square, [[1, 2, 3], [2, 0, 1], [0, 3, 1]], process=False)
    with refused(MeshError, "sheet", "volume"):  # and warnings are errors
        watertight(sheet, "sheet")
