"""Few convex pieces for meshes not made for collision queries: what they cover, and how far they stand out."""

from pathlib import Path

import numpy as np
import pytest
import trimesh

from grasp_refine.core.errors import MeshError
from grasp_refine.geometry import covering as module
from grasp_refine.geometry.covering import MAX_PIECES, OUTSIDE_TOLERANCE_M, Covering, covering, protrusion
from grasp_refine.geometry.pieces import Piece, box, hull
from refusals import assert_names, refused


def boxes(*bounds: list[float]) -> list[trimesh.Trimesh]:
    return [trimesh.creation.box(bounds=np.reshape(corners, (2, 3))) for corners in bounds]


@pytest.fixture(scope="module")
def clamp() -> trimesh.Trimesh:
    """A U of 60 x 40 x 20 mm with legs 10 mm wide and a base 10 mm high: its hull stands out by 20 mm."""
    parts = boxes([0, 0, 0, 60, 20, 10], [0, 0, 0, 10, 20, 40], [50, 0, 0, 60, 20, 40])
    return trimesh.boolean.union(parts).apply_scale(0.001)


def check_covered(found: Covering, mesh: trimesh.Trimesh) -> None:
    """Each vertex is in a piece, no piece leaves the hull, and the pieces stand out as far as is said, or less."""
    reach = np.stack([module._plane_distance(mesh.vertices, piece) for piece in found.pieces])
    assert reach.min(axis=0).max() <= OUTSIDE_TOLERANCE_M
    whole = hull(mesh.vertices)
    assert all(module._plane_distance(piece.vertices, whole).max() <= OUTSIDE_TOLERANCE_M for piece in found.pieces)
    again = protrusion(found.pieces, mesh, module.MIN_PROTRUSION_M)
    assert again == pytest.approx(found.stands_out, rel=0.05)


def test_a_convex_mesh_is_its_hull() -> None:
    found = covering(trimesh.creation.icosphere(radius=0.02), 1e-3)
    assert len(found.pieces) == 1
    assert (found.hull_stands_out, found.stands_out) == (0, 0)


def test_a_concave_body_is_cut_once(clamp: trimesh.Trimesh, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    lines: list[str] = []
    found = covering(clamp, 5e-3, cache=tmp_path, progress=lines.append, name="clamp.stl")
    assert found.hull_stands_out == pytest.approx(0.02, rel=0.06)
    assert 3 <= len(found.pieces) <= 5
    assert found.stands_out <= 5e-3
    assert "clamp.stl" in lines[0]
    check_covered(found, clamp)
    monkeypatch.setattr("grasp_refine.geometry.pieces.decompose", lambda *_, **__: pytest.fail("cut again"))
    again = covering(clamp, 5e-3, cache=tmp_path)
    assert (again.hull_stands_out, again.stands_out) == (found.hull_stands_out, found.stands_out)
    for a, b in zip(found.pieces, again.pieces, strict=True):
        np.testing.assert_array_equal(a.vertices, b.vertices)


def test_an_open_body_is_cut(clamp: trimesh.Trimesh) -> None:
    opened = clamp.copy()
    opened.update_faces(np.arange(len(clamp.faces)) != 3)
    assert not opened.is_watertight
    found = covering(opened, 5e-3)
    assert 3 <= len(found.pieces) <= 8
    assert found.stands_out <= 5e-3
    check_covered(found, clamp)


def test_bodies_inside_others_are_dropped() -> None:
    mesh = trimesh.util.concatenate(
        boxes([0, 0, 0, 0.02, 0.02, 0.02], [0.06, 0, 0, 0.08, 0.02, 0.02], [0.065, 0.005, 0.005, 0.07, 0.01, 0.01])
    )
    found = covering(mesh, 5e-3)
    assert len(found.pieces) == 2
    check_covered(found, mesh)


def test_many_small_bodies_are_joined_with_what_is_near() -> None:
    """A plate of 100 mm with 20 screws, and a block 60 mm above it."""
    screws = [
        [x, y, 0.004, x + 0.003, y + 0.003, 0.006] for x in np.linspace(0, 0.097, 4) for y in np.linspace(0, 0.097, 5)
    ]
    mesh = trimesh.util.concatenate(boxes([0, 0, 0, 0.1, 0.1, 0.005], [0, 0, 0.06, 0.1, 0.1, 0.08], *screws))
    assert mesh.body_count == 22
    found = covering(mesh, 5e-3)
    assert len(found.pieces) <= MAX_PIECES
    assert found.stands_out == 0
    check_covered(found, mesh)


def test_where_cutting_fails_the_hull_of_the_body_stays(
    clamp: trimesh.Trimesh, monkeypatch: pytest.MonkeyPatch
) -> None:
    # CoACD's process ends without a result where there is no CoACD.
    monkeypatch.setattr("grasp_refine.geometry.decomposition.sys.executable", "/bin/false")
    found = covering(clamp, 5e-3, name="clamp.stl")
    assert len(found.pieces) == 1
    assert found.stands_out == found.hull_stands_out > 0.019
    assert_names(found.trouble, "clamp.stl", "CoACD", "exit code 1")


@pytest.mark.parametrize("limit", [0.0, -1.0, np.nan])
def test_a_limit_that_is_none_is_refused(clamp: trimesh.Trimesh, limit: float) -> None:
    with refused(MeshError, f"{limit:g} m"):
        covering(clamp, limit)


def test_without_a_limit_the_hull_is_all(clamp: trimesh.Trimesh) -> None:
    found = covering(clamp, np.inf)
    assert len(found.pieces) == 1
    assert found.hull_stands_out == 0


def test_a_sheet_between_bodies_is_covered():
    corners = np.array([[0.02, 0, 0.01], [0.12, 0, 0.01], [0.12, 0.02, 0.01], [0.02, 0.02, 0.01]])
    sheet = trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3], [2, 1, 0], [3, 2, 0]], process=False)
    cubes = [trimesh.creation.box(bounds=[[x, 0, 0], [x + 0.02, 0.02, 0.02]]) for x in (0.0, 0.12)]
    found = covering(trimesh.util.concatenate([*cubes, sheet]), 5e-3)
    middle = np.array([0.07, 0.01, 0.01])
    assert any(((piece.planes[0] @ middle) <= piece.planes[1] + 1e-9).all() for piece in found.pieces)
    assert found.stands_out == 0.0


def test_an_open_bin_is_not_closed_by_a_lid():
    bin_ = trimesh.creation.box(bounds=[[0, 0, 0], [0.1, 0.1, 0.05]])
    bin_.update_faces(bin_.face_normals[:, 2] < 0.5)
    # Measured only: so large a limit cuts nothing.
    assert covering(bin_, 0.2).hull_stands_out == pytest.approx(0.05, rel=0.1)


def test_sides_that_do_not_hang_together_are_one_body():
    # As CAD programs write them: a patch for each side, a micrometre apart from the next.
    cubes = []
    for x in (0.0, 0.12):
        cube = trimesh.creation.box(bounds=[[x, 0, 0], [x + 0.02, 0.02, 0.02]])
        for normal in np.unique(np.round(cube.face_normals), axis=0):
            side = cube.submesh([np.flatnonzero((np.round(cube.face_normals) == normal).all(axis=1))], append=True)
            cubes.append(side.apply_translation(1e-6 * normal))
    found = covering(trimesh.util.concatenate(cubes), 5e-3)
    assert len(found.pieces) == 2
    assert sum(piece.mesh().volume for piece in found.pieces) == pytest.approx(2 * 0.02**3, rel=1e-3)


def test_the_worst_of_many_bodies_is_cut():
    clamp = trimesh.boolean.union(
        [trimesh.creation.box(bounds=b) for b in ([[0, 0, 0], [0.06, 0.02, 0.01]], [[0, 0, 0], [0.01, 0.02, 0.04]],
                                                  [[0.05, 0, 0], [0.06, 0.02, 0.04]])]
    )  # fmt: skip
    screws = [trimesh.creation.box(bounds=[[0.003 * i, 0.03, 0], [0.003 * i + 0.002, 0.032, 0.002]]) for i in range(18)]
    found = covering(trimesh.util.concatenate([clamp, *screws]), 5e-3)
    assert found.hull_stands_out > 0.015 and found.stands_out < 0.006
    assert len(found.pieces) <= MAX_PIECES


def stands_out(*bounds: list[float], pieces: tuple[Piece, ...] = (), least: float = 0.01, size: float = 1.0) -> float:
    """Protrusion from the union of some boxes, of their hull or of `pieces`."""
    mesh = trimesh.boolean.union(boxes(*bounds)).apply_scale(size)
    return protrusion(pieces or [hull(mesh.vertices)], mesh, least * size) / size


def piece(*bounds: float) -> Piece:
    """A box from its lower and upper corner."""
    low, high = np.reshape(bounds, (2, 3))
    return box(high - low).transformed(np.block([[np.eye(3), (high + low)[:, None] / 2], [np.zeros(3), 1.0]]))


@pytest.mark.parametrize("edge", [0.05, 0.3, 1.0])
def test_a_box_of_any_size_is_its_own_hull(edge: float) -> None:
    cube = trimesh.creation.box([edge, edge, edge])
    assert protrusion([hull(cube.vertices)], cube, 1e-3 * edge) == 0
    assert covering(cube, 5e-3).hull_stands_out == 0


L_SHAPE = [0, 0, 0, 3, 1, 1], [0, 0, 0, 1, 3, 1]


@pytest.mark.parametrize(
    ("bounds", "pieces", "expected"),
    [
        # The point (2, 2) of the slope from (3, 1) to (1, 3) is 1 away from each leg.
        pytest.param(L_SHAPE, (), 1.0, id="L shape"),
        pytest.param([[0, 0, 0, 1, 1, 1], [3, 0, 0, 4, 1, 1]], (), 1.0, id="two boxes"),
        # Across a notch of width 2 w and depth d the hull is at most min(w, d) away from walls and floor.
        pytest.param([[0, 0, 0, 10, 5, 1], [0, 0, 0, 4, 5, 4], [6, 0, 0, 10, 5, 4]], (), 1.0, id="narrow notch"),
        pytest.param([[0, 0, 0, 10, 5, 1], [0, 0, 0, 1, 5, 1.5], [9, 0, 0, 10, 5, 1.5]], (), 0.5, id="flat notch"),
        pytest.param(L_SHAPE, tuple(piece(*leg) for leg in L_SHAPE), 0.0, id="its legs"),
        # The cut along x = 1 faces the other piece, and counts for nothing.
        pytest.param(L_SHAPE, (piece(1, 0, 0, 3, 1, 1), piece(*L_SHAPE[1])), 0.0, id="its parts"),
        pytest.param(L_SHAPE, (piece(1, 0, 0, 3.25, 1, 1), piece(*L_SHAPE[1])), 0.25, id="a longer part"),
    ],
)
def test_protrusion_in_closed_form(bounds: list[list[float]], pieces: tuple[Piece, ...], expected: float) -> None:
    assert stands_out(*bounds, pieces=pieces, least=0.05) == pytest.approx(expected, rel=0.06)
    assert not stands_out(*bounds, pieces=pieces, least=max(1.1 * expected, 0.05))


def test_protrusion_scales_with_the_bodies() -> None:
    assert stands_out(*L_SHAPE, least=0.05, size=1e-3) == pytest.approx(1.0, rel=0.06)
