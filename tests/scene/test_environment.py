"""Bodies around the object: what hangs is swept down as far as the object is lifted."""

import numpy as np
import pytest

from grasp_refine.core.errors import GraspRefineError
from grasp_refine.geometry.body import build_body
from grasp_refine.geometry.pieces import Piece, box, capsule, sphere
from grasp_refine.scene.environment import HANGS_M, Environment, EnvironmentBody, swept

DICE = box([0.02, 0.03, 0.04])
SHAPES = (
    sphere(0.02, [0.1, 0, 0]),
    capsule(0.01, [0, 0, 0], [0, 0.03, 0.02]),
    DICE,
    Piece(DICE.vertices, DICE.faces, 0.01),
)


@pytest.mark.parametrize("piece", SHAPES)
def test_a_swept_piece_reaches_as_far_as_the_piece_at_either_end(piece: Piece) -> None:
    """In all directions; a capsule becomes a polyhedron inside of its own sweep."""
    way = np.array([0.01, -0.02, 0.05])
    directions = np.random.default_rng(0).normal(size=(200, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    found, start = ((directions @ one.vertices.T).max(axis=1) + one.radius for one in (swept(piece, way), piece))
    expected = start + np.maximum(directions @ way, 0.0)
    np.testing.assert_allclose(found, expected, atol=1e-3 if len(piece.vertices) == 2 else 1e-12)
    assert (found <= expected + 1e-9).all()


@pytest.mark.parametrize(("gap", "hangs"), [(-1e-4, False), (1e-4, True)])
def test_a_piece_hangs_whose_lowest_point_is_above_the_object(gap: float, hangs: bool) -> None:
    T = np.eye(4)
    T[2, 3] = 0.5
    bodies = []
    for name, piece, below in (("ball", sphere(0.02), 0.02), ("dice", DICE, 0.02)):
        pose = np.eye(4)
        pose[:3, 3] = 0.3, 0.0, 0.5 + HANGS_M + below + gap
        bodies.append(EnvironmentBody(name, build_body(name, [piece], candidates=16), pose))
    environment = Environment(tuple(bodies), T, lift=0.05)
    assert [environment.cleared(k) is not one.body for k, one in enumerate(bodies)] == [hangs, hangs]
    assert environment.boxes[:, 0, 2] == pytest.approx(HANGS_M + gap - 0.05 * hangs)


def test_names_of_bodies_are_printable_and_differ() -> None:
    ball = build_body("ball", [sphere(0.02)], candidates=16)
    for name in ("", "a/b", "a\n"):
        with pytest.raises(GraspRefineError, match="name"):
            EnvironmentBody(name, ball, np.eye(4))
    with pytest.raises(GraspRefineError, match="'a'"):
        Environment((EnvironmentBody("a", ball, np.eye(4)),) * 2, np.eye(4))
