"""Pairs of bodies: at their sizes, about their centres, drawn from what can be used and from nothing else."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh

from grasp_refine.core.errors import AssetError
from grasp_refine.geometry.body import Body, build_body
from grasp_refine.geometry.pieces import capsule, sphere
from grasp_refine.geometry.shapes import EMBEDDED
from grasp_refine_apps.bench.align.bodies import DIAGONALS, BodyPair, draw_pairs, mesh_sources, normalised
from refusals import refused
from shapes_for_tests import cluster_body, convex_body

ROUNDED = build_body("rounded", [sphere(0.02, [0.3, 0, 0]), capsule(0.01, [0, 0.1, 0], [0.1, 0.2, 0])], candidates=50)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder of a convex mesh, a concave one, a concave one in two parts, and a broken file."""
    monkeypatch.setenv("GRASP_REFINE_CACHE", str(tmp_path / "cache"))
    meshes = tmp_path / "meshes"
    meshes.mkdir()
    trimesh.creation.box((0.3, 0.2, 0.1)).export(meshes / "box.obj")
    for name, reach in (("two.obj", 2.0), ("apart.STL", 3.0)):
        parts = [trimesh.creation.box((1, 1, 1)), trimesh.creation.box((1, 0.5, 1))]
        parts[1].apply_translation([reach, 0, 0])
        trimesh.util.concatenate(parts).export(meshes / name, file_type=name[-3:].lower())
    (meshes / "broken.ply").write_text("no mesh")
    (meshes / "notes.txt").write_text("no mesh either")
    return meshes


def drawn(sources: list[str | Path], kind: str = "convex", count: int = 4, seed: int = 0) -> list[BodyPair]:
    return draw_pairs(sources, kind, count, seed, say=lambda line: None, candidates=64)


def sizes(pairs: list[BodyPair]) -> list[tuple[str, float, float]]:
    return [(pair.name, pair.a.diagonal, pair.b.diagonal) for pair in pairs]


@pytest.mark.parametrize("body", [convex_body(1, 20), cluster_body(2, 3), ROUNDED], ids=lambda body: body.name)
@pytest.mark.parametrize("diagonal", [0.01, 0.3])
def test_a_normalised_body_has_its_diagonal_about_its_origin(body: Body, diagonal: float):
    made = normalised(body, diagonal)
    bounds = np.stack([piece.bounds for piece in made.pieces])
    lower, upper = bounds[:, 0].min(axis=0), bounds[:, 1].max(axis=0)
    np.testing.assert_allclose(lower, -upper, atol=1e-12 * diagonal)
    assert made.diagonal == pytest.approx(diagonal) and np.linalg.norm(upper - lower) == pytest.approx(diagonal)
    factor = diagonal / body.diagonal
    assert made.area == pytest.approx(body.area * factor**2)
    np.testing.assert_allclose(made.candidates.areas, body.candidates.areas * factor**2)
    np.testing.assert_array_equal(made.candidates.normals, body.candidates.normals)
    np.testing.assert_allclose([p.radius for p in made.pieces], [p.radius * factor for p in body.pieces])
    assert made.name == body.name


def test_pairs_are_of_different_objects_at_sizes_of_the_range():
    pairs = drawn(mesh_sources(None), count=40)
    assert len(pairs) == 40
    assert all(pair.a.name != pair.b.name for pair in pairs)
    assert {name for pair in pairs for name in (pair.a.name, pair.b.name)} == set(EMBEDDED)
    for pair in pairs:
        assert pair.name == " / ".join(f"{body.name} {1e3 * body.diagonal:.1f} mm" for body in (pair.a, pair.b))
    assert len({pair.name for pair in pairs}) == len(pairs)
    diagonals = np.array([(pair.a.diagonal, pair.b.diagonal) for pair in pairs])
    low, high = DIAGONALS
    assert low <= diagonals.min() < 0.04 and 0.17 < diagonals.max() <= high
    # Drawn evenly: the mean is that of the range to within three standard errors.
    assert abs(diagonals.mean() - 0.5 * (low + high)) < 3 * (high - low) / np.sqrt(12 * diagonals.size)


def test_what_cannot_be_used_is_reported_and_left_out(folder: Path):
    said: list[str] = []
    pairs = draw_pairs(mesh_sources(folder), "convex", 6, 0, say=said.append, candidates=64)
    assert {body.name for pair in pairs for body in (pair.a, pair.b)} == {"box", "two", "apart"}
    assert len(said) == 1, "each mesh is loaded once"
    assert "broken.ply" in said[0]
    # The box is convex, which is no fault.
    said.clear()
    pairs = draw_pairs(mesh_sources(folder), "concave", 3, 0, say=said.append, candidates=64)
    assert {body.name for pair in pairs for body in (pair.a, pair.b)} == {"two", "apart"}
    assert [line for line in said if re.search(r"\bbox\b", line)] == []


@pytest.mark.parametrize(
    ("make", "named"),
    [
        (lambda path: None, ()),
        (lambda path: path.mkdir(), (".obj", ".stl")),
        (lambda path: path.write_text("a file"), ()),
    ],
)
def test_a_folder_without_meshes_is_refused(make: Callable[[Path], object], named: tuple[str, ...], tmp_path: Path):
    make(tmp_path / "nowhere")
    with refused(AssetError, "--meshes", tmp_path / "nowhere", *named):
        mesh_sources(tmp_path / "nowhere")
