"""Convex pieces: hulls, primitives, and the decomposition of concave meshes with its cache."""

import threading
import time
from dataclasses import fields
from importlib.metadata import version

import numpy as np
import pytest
import trimesh

from grasp_refine.core.errors import MeshError
from grasp_refine.geometry import cache as disk
from grasp_refine.geometry import pieces as pieces_module
from grasp_refine.geometry.cache import default_cache
from grasp_refine.geometry.decomposition import TIME_LIMIT_S, OutOfTimeError
from grasp_refine.geometry.mesh import FlatMeshError
from grasp_refine.geometry.pieces import (
    SHIPPED,
    Decomposition,
    Piece,
    box,
    capsule,
    convex_pieces,
    cut_meshes,
    cylinder,
    hull,
    sphere,
    unit_pieces,
)
from grasp_refine.geometry.shapes import EMBEDDED
from refusals import assert_names, refused


def pose(seed: int) -> np.ndarray:
    T = trimesh.transformations.random_rotation_matrix(np.random.default_rng(seed).random(3))
    T[:3, 3] = np.random.default_rng(seed).normal(size=3)
    return T


def l_shape() -> trimesh.Trimesh:
    """An L of two boxes: 4 x 4 x 2 cm less a quarter."""
    whole = trimesh.creation.box([4, 4, 2])
    quarter = trimesh.creation.box([4, 4, 4])
    quarter.apply_translation([2.5, 2.5, 0])
    mesh = trimesh.boolean.difference([whole, quarter])
    return mesh.apply_scale(0.01)


@pytest.fixture
def bracket() -> trimesh.Trimesh:
    return l_shape()


@pytest.fixture(scope="module")
def parts() -> list[np.ndarray]:
    """What CoACD cuts the bracket into, as it gives it."""
    found, decompose = [], pieces_module.decompose

    def record(*given, **options):
        found.extend(decompose(*given, **options))
        return found

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(pieces_module, "decompose", record)
        convex_pieces(l_shape())
    return found


@pytest.fixture
def known_cut(parts, monkeypatch):
    """Whatever is cut becomes the parts of the bracket, without a search of half a second."""
    monkeypatch.setattr(pieces_module, "decompose", lambda *_, **__: parts)


def test_hull_keeps_the_corners_of_a_box_and_nothing_inside():
    corners = np.array([[x, y, z] for x in (0, 0.1) for y in (0, 0.2) for z in (0, 0.3)])
    inside = np.random.default_rng(0).uniform([0, 0, 0], [0.1, 0.2, 0.3], (500, 3))
    piece = hull(np.concatenate([inside, corners]))
    assert sorted(map(tuple, piece.vertices)) == sorted(map(tuple, corners))
    assert piece.mesh().is_volume
    assert piece.mesh().volume == pytest.approx(0.1 * 0.2 * 0.3)
    assert piece.vertices.dtype == np.float64 and piece.faces.dtype == np.int64


@pytest.mark.parametrize("size", [1e-5, 1.0, 1e4])
@pytest.mark.parametrize("seed", range(3))
def test_hull_supports_its_points_and_faces_outward(size, seed):
    rng = np.random.default_rng(seed)
    points = size * (rng.normal(size=(200, 3)) + 10 * rng.normal(size=3))
    piece = hull(points)
    directions = rng.normal(size=(100, 3))
    np.testing.assert_allclose((piece.vertices @ directions.T).max(0), (points @ directions.T).max(0))
    normals, offsets = piece.planes
    assert (points @ normals.T - offsets).max() < 1e-9 * size
    assert (piece.vertices.mean(0) @ normals.T - offsets).max() < 0
    assert piece.mesh().is_volume


@pytest.mark.parametrize(
    ("points", "kind", "named"),
    [
        (np.eye(3), FlatMeshError, ("4 points", "(3, 3)")),
        (np.zeros((5, 2)), FlatMeshError, ("4 points", "(5, 2)")),
        (np.full((6, 3), 0.2), FlatMeshError, ("0 m",)),
        (np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, np.nan]]), MeshError, ("1 of its 4 vertices",)),
        (np.array([[0, 0, 0], [1, 0, 0], [0, np.inf, 0], [0, 0, 1]]), MeshError, ("1 of its 4 vertices",)),
        (np.outer(np.arange(6), [1.0, 2.0, 3.0]), FlatMeshError, ("1e-06",)),
        (np.random.default_rng(0).random((20, 3)) * [1, 1, 0], FlatMeshError, ("1e-06",)),
        (np.random.default_rng(0).random((20, 3)) * [1, 1, 1e-8], FlatMeshError, ("1e-06",)),
    ],
)
def test_hull_refuses_what_has_no_volume(points, kind, named):
    with refused(kind, "link finger", *named):
        hull(points, name="link finger")


def test_box_and_cylinder_have_their_closed_form_volumes():
    T = pose(1)
    assert box([0.1, 0.2, 0.3], T).mesh().volume == pytest.approx(0.006)
    np.testing.assert_allclose(box([0.1, 0.2, 0.3], T).vertices.mean(0), T[:3, 3])
    for sides in (3, 96):
        exact = sides / 2 * np.sin(2 * np.pi / sides) * 0.02**2 * 0.1
        assert cylinder(0.02, 0.1, T, sides).mesh().volume == pytest.approx(exact)


def test_cylinder_stays_within_the_bound_that_it_states():
    prism = cylinder(0.02, 0.1)
    directions = np.random.default_rng(0).normal(size=(2000, 3)) * [1, 1, 0]
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    support = (prism.vertices @ directions.T).max(0)
    assert support.max() <= 0.02 * (1 + 1e-12)
    assert support.min() >= 0.02 * np.cos(np.pi / 96) * (1 - 1e-12)
    np.testing.assert_allclose(np.abs(prism.vertices[:, 2]), 0.05)


def test_round_pieces_are_exact_cores_and_tessellate_on_their_surface():
    ball, rod = sphere(0.02, [1, 2, 3]), capsule(0.02, [0, 0, 0], [0, 0, 0.1])
    assert ball.vertices.shape == (1, 3) and rod.vertices.shape == (2, 3)
    assert ball.faces.shape == rod.faces.shape == (0, 3)
    np.testing.assert_allclose(np.linalg.norm(ball.mesh().vertices - [1, 2, 3], axis=1), 0.02)
    along = rod.mesh().vertices[:, 2].clip(0, 0.1)
    np.testing.assert_allclose(np.linalg.norm(rod.mesh().vertices - np.outer(along, [0, 0, 1]), axis=1), 0.02)
    assert rod.mesh().volume == pytest.approx(np.pi * 0.02**2 * (0.1 + 4 / 3 * 0.02), rel=0.02)
    assert capsule(0.02, [1, 2, 3], [1, 2, 3]).vertices.shape == (1, 3)
    np.testing.assert_allclose(rod.bounds, [[-0.02, -0.02, -0.02], [0.02, 0.02, 0.12]])


def test_transformed_moves_the_support_points():
    T = pose(2)
    for piece in (box([0.1, 0.2, 0.3]), capsule(0.02, [0, 0, 0], [0, 0, 0.1])):
        moved = piece.transformed(T)
        np.testing.assert_allclose(moved.vertices, trimesh.transform_points(piece.vertices, T))
        assert moved.radius == piece.radius
        assert moved.mesh().volume == pytest.approx(piece.mesh().volume, rel=1e-3)


@pytest.mark.parametrize(
    ("make", "named"),
    [
        (lambda: sphere(0), ("sphere", "radius", "0.0")),
        (lambda: sphere(np.nan), ("sphere", "radius", "nan")),
        (lambda: sphere(1, [0, np.inf, 0]), ("sphere", "centre")),
        (lambda: capsule(-1, [0, 0, 0], [0, 0, 1]), ("capsule", "radius", "-1")),
        (lambda: box([1, 0, 1]), ("box", "0")),
        (lambda: cylinder(1, np.inf), ("cylinder", "radius", "length", "inf")),
        (lambda: cylinder(1, 1, sides=2), ("cylinder", "3 sides", "2")),
    ],
)
def test_primitives_refuse_sizes_that_make_no_solid(make, named):
    with refused(MeshError, *named):
        make()


def test_slivers_have_no_normal_and_give_no_plane():
    flat_face = np.array([[0, 0, 0], [1, 0, 0], [0.5, 1e-12, 0], [0, 1, 0], [0, 0, 1.0]])
    piece = Piece(flat_face, np.array([[0, 2, 1], [0, 3, 1], [0, 4, 3], [0, 1, 4], [1, 3, 4]]))
    assert not piece.normals[0].any()
    assert len(piece.planes[0]) == 4
    np.testing.assert_allclose(np.linalg.norm(piece.planes[0], axis=1), 1)


def test_a_convex_mesh_is_its_hull_without_any_search(tmp_path):
    lines = []
    (piece,) = convex_pieces(trimesh.creation.icosphere(2), cache=tmp_path, progress=lines.append)
    assert len(piece.vertices) == 162
    assert lines == [] and list(tmp_path.iterdir()) == []


def test_a_bracket_becomes_pieces_that_cover_it(bracket):
    lines = []
    pieces = convex_pieces(bracket, progress=lines.append, name="bracket")
    assert 2 <= len(pieces) <= 4
    assert sum(piece.mesh().volume for piece in pieces) == pytest.approx(bracket.volume, rel=0.02)
    points, _ = trimesh.sample.sample_surface(bracket, 500, seed=0)
    depths = [(points @ piece.planes[0].T - piece.planes[1]).max(1) for piece in pieces]
    assert np.min(depths, axis=0).max() < 1e-4
    assert_names(lines[0], "bracket", f"{len(bracket.faces)} faces", "CoACD", "threshold 0.05")
    assert_names(lines[1], "bracket", f"{len(pieces)} convex pieces")


def same(one, other, scale=1.0):
    assert len(one) == len(other)
    for a, b in zip(one, other, strict=True):
        np.testing.assert_allclose(a.vertices * scale, b.vertices, rtol=1e-12)
        np.testing.assert_array_equal(a.faces, b.faces)


def test_an_entry_serves_the_mesh_again_at_every_scale(bracket, known_cut, tmp_path):
    lines = []
    folder = tmp_path / "deep" / "pieces"
    first = convex_pieces(bracket, cache=folder, progress=lines.append)
    assert len(lines) == 2
    same(first, convex_pieces(bracket, cache=folder, progress=lines.append))
    for scale in (1 / 3, 1e-3, 77.7):
        larger = bracket.copy().apply_scale(scale)
        same(first, convex_pieces(larger, cache=folder, progress=lines.append), scale)
    assert len(lines) == 2
    assert [entry.suffix for entry in folder.iterdir()] == [".npz"]


def test_other_settings_and_other_meshes_have_entries_of_their_own(bracket, known_cut, tmp_path):
    convex_pieces(bracket, cache=tmp_path)
    convex_pieces(bracket, Decomposition(threshold=0.2), cache=tmp_path)
    bracket.vertices[0] += 1e-4
    convex_pieces(bracket, cache=tmp_path)
    assert len(list(tmp_path.iterdir())) == 3


def broken_entries():
    vertices, faces = np.zeros((4, 3)), np.zeros((4, 3), dtype=np.int64)
    sound = {"vertices": vertices, "faces": faces, "vertex_counts": [4], "face_counts": [4]}
    return {
        "empty": b"",
        "noise": b"PK\x03\x04 this is not an archive",
        "missing array": {"vertices": vertices},
        "object array": sound | {"faces": np.array([None] * 4)},
        "wrong kind": sound | {"faces": faces.astype(float)},
        "wrong shape": sound | {"vertices": np.zeros((4, 2))},
        "no pieces": sound | {"vertex_counts": np.zeros(0, int), "face_counts": np.zeros(0, int)},
        "counts that do not add up": sound | {"vertex_counts": [5]},
        "index beyond": sound | {"faces": faces + 4},
        "not finite": sound | {"vertices": vertices * np.nan},
    }


@pytest.mark.parametrize("kind", [*broken_entries(), "cut short", "flipped byte"])
def test_a_broken_entry_is_rebuilt(bracket, known_cut, tmp_path, kind):
    first = convex_pieces(bracket, cache=tmp_path)
    (entry,) = tmp_path.iterdir()
    good = entry.read_bytes()
    if kind == "cut short":
        entry.write_bytes(good[: len(good) // 2])
    elif kind == "flipped byte":
        entry.write_bytes(good[:300] + bytes([good[300] ^ 255]) + good[301:])
    elif isinstance(broken := broken_entries()[kind], bytes):
        entry.write_bytes(broken)
    else:
        np.savez(entry, **broken)
    lines = []
    same(first, convex_pieces(bracket, cache=tmp_path, progress=lines.append))
    assert len(lines) == 2
    same(first, convex_pieces(bracket, cache=tmp_path, progress=lines.append))
    assert len(lines) == 2


def test_an_entry_that_fails_while_it_is_written_leaves_nothing_behind(tmp_path, monkeypatch):
    cube = box([1, 1, 1])

    def fail(file, **arrays):
        file.write(b"half an entry")
        raise KeyboardInterrupt

    monkeypatch.setattr(disk.np, "savez", fail)
    with pytest.raises(KeyboardInterrupt):
        disk.save(tmp_path / "entry.npz", [(cube.vertices, cube.faces)])
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_cannot_be_written_to_only_costs_the_entry(bracket, known_cut, tmp_path):
    (tmp_path / "file").write_text("in the way")
    lines = []
    assert convex_pieces(bracket, cache=tmp_path / "file" / "pieces", progress=lines.append)
    assert str(tmp_path / "file") in lines[-1]


def test_flat_parts_are_dropped_and_counted(bracket, monkeypatch):
    cube = box([0.1, 0.1, 0.1]).vertices
    monkeypatch.setattr(pieces_module, "decompose", lambda *_, **__: [cube * [1, 1, 0], cube])
    lines = []
    assert len(convex_pieces(bracket, progress=lines.append)) == 1
    assert "1 flat" in lines[-1]
    monkeypatch.setattr(pieces_module, "decompose", lambda *_, **__: [cube * [1, 1, 0]])
    with refused(MeshError, "bracket", "CoACD", "1 flat"):
        convex_pieces(bracket, name="bracket")


@pytest.fixture
def slow_cuts(monkeypatch):
    """What is decomposed meanwhile: [at most at once, in all]; each mesh becomes its hull, the larger ones last."""
    lock, count = threading.Lock(), [0, 0, 0]

    def decompose(vertices, faces, config, **_):
        with lock:
            count[2] += 1
            count[0] = max(count[0], count[2])
            count[1] += 1
        time.sleep(0.01 * len(faces) / 20)
        with lock:
            count[2] -= 1
        return [vertices]

    monkeypatch.setattr(pieces_module, "decompose", decompose)
    monkeypatch.setattr(pieces_module, "usable_cores", lambda: 2)
    return count


def brackets(bracket, number):
    """Meshes with names, each other a little different."""
    meshes = []
    for n in range(number):
        mesh = bracket.copy()
        mesh.vertices[0] *= 1 - 0.02 * n
        meshes.append((f"bracket {n}", mesh))
    return meshes


def test_every_setting_of_the_decomposition_has_entries_of_its_own(bracket, slow_cuts, tmp_path):
    others = {
        "threshold": 0.2, "max_pieces": 3, "preprocess": "on", "preprocess_resolution": 60, "resolution": 3000,
        "mcts_nodes": 30, "mcts_iterations": 100, "mcts_max_depth": 4, "merge": False, "seed": 1,
    }  # fmt: skip
    assert [*others] == [field.name for field in fields(Decomposition) if field.name != "time_limit"]
    for changed in ({}, *({name: value} for name, value in others.items())):
        convex_pieces(bracket, Decomposition(**changed), cache=tmp_path)
    assert slow_cuts[1] == len(list(tmp_path.iterdir())) == 1 + len(others)


def test_several_meshes_are_cut_at_a_time_and_come_back_in_order(bracket, slow_cuts, tmp_path):
    lines = []
    meshes = brackets(bracket, 5)
    found = cut_meshes(meshes, cache=tmp_path, progress=lines.append)
    assert slow_cuts[:2] == [2, 5]
    for (_, mesh), cut in zip(meshes, found, strict=True):
        (piece,) = cut.pieces
        np.testing.assert_allclose(piece.bounds, mesh.bounds, atol=1e-9)
    assert len(list(tmp_path.iterdir())) == 5
    for n in range(5):
        assert any(f"{n + 1} of 5" in line for line in lines)
    cut_meshes(meshes, cache=tmp_path)
    assert slow_cuts[1] == 5


def test_a_mesh_of_several_scales_is_cut_once_also_without_a_cache(bracket, slow_cuts):
    sizes = (1.0, 0.3, 7.0)
    found = cut_meshes([("bracket", bracket.copy().apply_scale(size)) for size in sizes])
    assert slow_cuts[1] == 1
    for size, cut in zip(sizes, found, strict=True):
        (piece,) = cut.pieces
        np.testing.assert_allclose(piece.bounds, size * bracket.bounds, atol=1e-8)


@pytest.mark.slow
def test_the_number_of_processes_changes_no_piece(bracket, monkeypatch):
    meshes = brackets(bracket, 2)
    monkeypatch.setattr(pieces_module, "usable_cores", lambda: 1)
    alone = cut_meshes(meshes)
    monkeypatch.setattr(pieces_module, "usable_cores", lambda: 2)
    for one, other in zip(alone, cut_meshes(meshes), strict=True):
        for a, b in zip(one.pieces, other.pieces, strict=True):
            assert a.vertices.tobytes() == b.vertices.tobytes() and a.faces.tobytes() == b.faces.tobytes()


@pytest.mark.parametrize("ending", [KeyboardInterrupt, ValueError])
def test_what_was_cut_before_the_end_is_kept_and_what_runs_is_ended(bracket, tmp_path, monkeypatch, ending):
    meshes = brackets(bracket, 3)
    first, ended = [True], []

    def decompose(vertices, faces, config, *, check, **_):
        if first and first.pop():
            return [vertices]
        try:
            while True:
                time.sleep(0.01)
                check()
        finally:
            ended.append(True)

    def interrupt(line):
        if "bracket 2" in line:
            raise ending

    monkeypatch.setattr(pieces_module, "decompose", decompose)
    monkeypatch.setattr(pieces_module, "usable_cores", lambda: 2)
    with pytest.raises(ending):
        cut_meshes(meshes, cache=tmp_path, progress=interrupt)
    assert ended == [True] and len(list(tmp_path.iterdir())) == 1


@pytest.fixture
def endless(monkeypatch):
    """Settings of each decomposition; those that ask for a finer threshold than 0.1 never end in time."""
    asked = []

    def decompose(vertices, faces, config, **_):
        asked.append(config)
        if config.threshold < 0.1:
            raise OutOfTimeError("too long")
        return [vertices, vertices / 2]

    monkeypatch.setattr(pieces_module, "decompose", decompose)
    return asked


def test_beyond_the_time_limit_coarser_pieces_are_used_and_said_to_be_each_time(bracket, endless, tmp_path):
    (cut,) = cut_meshes([("bracket", bracket)], cache=tmp_path)
    assert len(cut.pieces) == 2
    assert_names(cut.shortfall, f"{TIME_LIMIT_S:g} s", "2 coarser pieces", "threshold 0.1")
    assert [(c.threshold, c.time_limit) for c in endless] == [(0.05, TIME_LIMIT_S), (0.1, TIME_LIMIT_S / 2)]
    lines = []
    (again,) = cut_meshes([("bracket", bracket)], cache=tmp_path, progress=lines.append)
    assert len(endless) == 2 and again.shortfall == cut.shortfall and cut.shortfall in lines[0]
    # More time is another request, and what comes of it in time has no note, for any limit.
    cut_meshes([("bracket", bracket)], Decomposition(time_limit=2 * TIME_LIMIT_S), cache=tmp_path)
    assert len(endless) == 4
    (full,) = cut_meshes([("bracket", bracket)], Decomposition(threshold=0.1), cache=tmp_path)
    assert full.shortfall == ""


def test_where_coarser_pieces_take_too_long_the_hull_is_used(bracket, monkeypatch, tmp_path):
    def decompose(*_, **__):
        raise OutOfTimeError("too long")

    monkeypatch.setattr(pieces_module, "decompose", decompose)
    for _ in range(2):
        (cut,) = cut_meshes([("bracket", bracket)], cache=tmp_path)
        (piece,) = cut.pieces
        np.testing.assert_allclose(piece.bounds, bracket.bounds, atol=1e-8)
        assert_names(cut.shortfall, f"{TIME_LIMIT_S:g} s", "convex hull")


def test_the_time_limit_is_no_part_of_the_name_of_an_entry(bracket, slow_cuts, tmp_path):
    for limit in (60, 120, np.inf):
        convex_pieces(bracket, Decomposition(time_limit=limit), cache=tmp_path)
    assert slow_cuts[1] == 1


def test_progress_is_said_while_a_mesh_is_cut(bracket, monkeypatch):
    monkeypatch.setattr(pieces_module, "PROGRESS_INTERVAL_S", 0.01)

    def decompose(vertices, *_, **__):
        time.sleep(0.1)
        return [vertices]

    monkeypatch.setattr(pieces_module, "decompose", decompose)
    lines = []
    convex_pieces(bracket, progress=lines.append, name="bracket")
    assert len(lines) > 3 and all("bracket" in line for line in lines)


CONCAVE = [name for name in EMBEDDED if name != "rounded_box"]


@pytest.mark.skipif(version("coacd") != "1.0.14", reason="another CoACD than that which cut them may cut otherwise")
@pytest.mark.parametrize(
    "name", [name if name == "bottle" else pytest.param(name, marks=pytest.mark.slow) for name in CONCAVE]
)
def test_pieces_that_come_with_the_program_are_what_cutting_gives(name):
    entry, pieces = unit_pieces(EMBEDDED[name](), name=name)
    there = disk.load(SHIPPED / entry)
    assert len(there) == len(pieces)
    for (vertices, faces), (own_vertices, own_faces) in zip(there, pieces, strict=True):
        np.testing.assert_allclose(vertices, own_vertices, atol=1e-9)
        np.testing.assert_array_equal(faces, own_faces)


def test_other_settings_take_no_pieces_that_come_with_the_program(slow_cuts):
    mesh = EMBEDDED["bottle"]()
    assert len(convex_pieces(mesh)) == 2 and slow_cuts[1] == 0
    assert len(convex_pieces(mesh, Decomposition(threshold=0.2))) == 1 and slow_cuts[1] == 1


def test_the_cache_folder_can_be_set(monkeypatch, tmp_path):
    monkeypatch.setenv("GRASP_REFINE_CACHE", str(tmp_path))
    assert default_cache() == tmp_path / "pieces"
    monkeypatch.delenv("GRASP_REFINE_CACHE")
    assert default_cache().name == "pieces" and default_cache() != tmp_path / "pieces"
