"""Witness points and their gradients: what moving, exchanging, reordering and repeating bodies may not change.

Bodies are a millimetre to ten metres in size, at any gap and depth, anywhere within a kilometre. A signed distance is
wrong if it is off by more than 1e-8 of the larger diagonal, 1e-12 m and 1e-15 of the position.
"""

from dataclasses import dataclass, replace
from functools import cache, cached_property

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

import twists
from exact_twists import angles, axes
from grasp_refine.collision.engine import engines
from grasp_refine.collision.query import Pairs, Witness, query
from grasp_refine.core.se3 import body_gradient, exp_se3, exp_so3, transform
from grasp_refine.geometry.body import Body, build_body
from grasp_refine.geometry.pieces import Piece, box, capsule, sphere
from grasp_refine.witness.analytical import Analytical
from grasp_refine.witness.autograd import WitnessLayer
from grasp_refine.witness.contact_kinematics import ContactKinematics
from grasp_refine.witness.derivative import Derivative
from grasp_refine.witness.direction import Direction
from grasp_refine.witness.distance import Distance
from grasp_refine.witness.finite_difference import FiniteDifference
from grasp_refine.witness.neighborhood import Fixed
from grasp_refine.witness.rings import Neighbor
from shapes_for_tests import cluster_body, ellipsoid_hull, ring_body
from twists import FIELDS

FEWER = settings(max_examples=max(8, settings().max_examples // 3))

CONVEX = {
    "ball": [sphere(0.3)],
    "capsule": [capsule(0.1, (0.0, 0.1, -0.4), (0.0, 0.0, 0.4))],
    "box": [box([0.6, 0.5, 0.4])],
    "needle": [box([0.02, 0.03, 1.0])],
    "plate": [box([0.7, 0.7, 0.002])],
    "hull": [ellipsoid_hull(0, 80, (0.5, 0.3, 0.2))],
    "thick hull": [replace(ellipsoid_hull(1, 12, (0.3, 0.3, 0.2)), radius=0.1)],
}
CONCAVE = {
    "ring": [piece.scaled(8.0) for piece in ring_body().pieces],
    "cluster": [piece.scaled(6.0) for piece in cluster_body(3).pieces],
}
KINDS = {**CONVEX, **CONCAVE}
SIZES = (1e-3, 0.1, 10.0)
"""What bodies of about a metre are scaled by."""

METHODS: dict[str, Derivative] = {
    "contact kinematics": ContactKinematics(),
    "contact kinematics, fixed": ContactKinematics(Fixed()),
    "distance": Distance(),
    "distance, neighbor": Distance(Neighbor()),
    "direction": Direction(),
    "analytical": Analytical(),
    "finite difference": FiniteDifference(),
}


@cache
def body(kind: str, size: float) -> Body:
    return build_body(kind, [piece.scaled(size) for piece in KINDS[kind]], candidates=256)


@cache
def pairs_of(kind_a: str, kind_b: str, size: float, engine: str) -> Pairs:
    return Pairs((body(kind_a, size),), (body(kind_b, size),), engine=engine)


def turn(angle: float, axis: np.ndarray) -> np.ndarray:
    return exp_so3(angle * axis)


rotations = st.builds(turn, angles(), axes())
seeds = st.integers(0, 2**32 - 1)
GAPS = (np.nan, 0.5, 1e-2, 1e-4, 1e-7, 1e-9, 0.0, -1e-9, -1e-4, -1e-2)
"""Signed distances over the size to which bodies are brought; NaN: they stay where they are."""

relations = st.tuples(rotations, axes(), st.floats(0.0, 3.0), st.sampled_from(GAPS))
"""How b lies beside a: turned, in a direction, as far away as so many sizes, then brought to a gap."""


@dataclass(frozen=True, eq=False)
class Meeting:
    """Two bodies, and how they meet a few times."""

    a: str
    b: str
    size: float
    engine: str
    relations: list[tuple[np.ndarray, np.ndarray, float, float]]
    place: float
    seed: int

    @property
    def pairs(self) -> Pairs:
        return pairs_of(self.a, self.b, self.size, self.engine)

    @property
    def swapped(self) -> Pairs:
        return pairs_of(self.b, self.a, self.size, self.engine)

    @cached_property
    def poses(self) -> tuple[np.ndarray, np.ndarray]:
        """Poses (batch, 1, 4, 4) of both."""
        rng, count = np.random.default_rng(self.seed), len(self.relations)
        R = exp_so3(rng.normal(size=(count, 1, 3)) * 2.0)
        T_a = transform(R, self.place * rng.normal(size=(count, 1, 3)))
        turned, direction, away, gap = (np.array(part) for part in zip(*self.relations, strict=True))
        T_b = transform(R @ turned[:, None], T_a[..., :3, 3] + self.size * (away[:, None] * direction)[:, None])
        found = query(self.pairs, T_a, T_b)
        shift = (self.size * gap[:, None] - found.distance)[..., None] * found.normal
        T_b[..., :3, 3] += np.where(np.isnan(gap[:, None, None]), 0.0, shift)
        return T_a, T_b

    @property
    def T_a(self) -> np.ndarray:
        return self.poses[0]

    @property
    def T_b(self) -> np.ndarray:
        return self.poses[1]

    def ask(self, rows: object = slice(None)) -> Witness:
        return query(self.pairs, self.T_a[rows], self.T_b[rows])

    def tolerance(self, *moved: np.ndarray) -> float:
        """How far an answer may be off at the poses, and at others of which the rounding comes on top."""
        diagonal = max(side.diagonal for side in (self.pairs.a[0], self.pairs.b[0]))
        far = max(np.abs(T[..., :3, 3]).max() for T in (self.T_a, self.T_b, *moved))
        return 1e-8 * diagonal + 1e-12 + 1e-15 * far


def meetings(kinds: tuple[str, ...] = tuple(KINDS), batch: int = 3) -> st.SearchStrategy[Meeting]:
    """Bodies at gaps of any sign and down to nothing, anywhere in the world."""
    return st.builds(
        Meeting, st.sampled_from(kinds), st.sampled_from(kinds), st.sampled_from(SIZES), st.sampled_from(engines()),
        st.lists(relations, min_size=batch, max_size=batch), st.sampled_from([0.0, 1.0, 1e3]), seeds,
    )  # fmt: skip


def highest(pieces: list[Piece], T: np.ndarray, n: np.ndarray) -> np.ndarray:
    """How far bodies of one piece at poses (batch, 1, 4, 4) reach along the directions (batch, 1, 3), in the world."""
    (piece,) = pieces
    along = np.einsum("bpij,vj,bpi->bpv", T[..., :3, :3], piece.vertices, n)
    return along.max(axis=-1) + piece.radius


# the answer itself


@given(meetings(tuple(CONVEX)))
def test_a_plane_across_the_normal_proves_the_distance(meeting: Meeting) -> None:
    """No body reaches beyond its plane, apart or not, and the planes are the signed distance apart."""
    w, between = meeting.ask(), meeting.T_b[..., :3, 3] - meeting.T_a[..., :3, 3]
    assert w.valid.all()
    np.testing.assert_allclose(np.linalg.norm(w.normal, axis=-1), 1.0, rtol=1e-12)
    front = highest(meeting.pairs.a[0].pieces, meeting.T_a, w.normal)
    back = (w.normal * between).sum(axis=-1) - highest(meeting.pairs.b[0].pieces, meeting.T_b, -w.normal)
    np.testing.assert_allclose(back - front, w.distance, rtol=0, atol=meeting.tolerance())
    across = w.point_b - w.point_a
    np.testing.assert_allclose(across, w.distance[..., None] * w.normal, rtol=0, atol=meeting.tolerance())


# rigid motions and the other order


@given(meetings(), rotations, axes(), st.sampled_from([0.0, 1e-3, 1.0, 1e3]))
def test_the_whole_world_moved_is_the_same_world(
    meeting: Meeting, R: np.ndarray, direction: np.ndarray, away: float
) -> None:
    M = transform(R, away * direction)
    T_a, T_b = M @ meeting.T_a, M @ meeting.T_b
    w, moved = meeting.ask(), query(meeting.pairs, T_a, T_b)
    np.testing.assert_allclose(moved.distance, w.distance, rtol=0, atol=2 * meeting.tolerance(T_a, T_b))


# the batch


# gradients


def gradients(layer: WitnessLayer, poses: tuple[np.ndarray, np.ndarray], covectors: np.ndarray) -> np.ndarray:
    """Gradients (2, batch, 1, 4, 4) of the fields times the covectors (batch, 1, 10) in the entries of both poses."""
    parts = np.split(covectors, (3, 6, 9), axis=-1)
    cotangents = dict(zip(FIELDS, (*parts[:3], parts[3][..., 0]), strict=True))
    return twists.gradients(layer, *poses, cotangents).numpy()


@FEWER
@given(meetings(batch=2), rotations, seeds, st.sampled_from(sorted(METHODS)))
def test_gradients_turn_with_the_world(meeting: Meeting, R: np.ndarray, seed: int, name: str) -> None:
    """Seen from the bodies nothing has changed: body twists of the gradients stay what they were."""
    rng = np.random.default_rng(seed)
    c, M = rng.normal(size=(2, 1, 10)), transform(R, np.zeros(3))
    # At symmetric poses several surface samples are equally near, and rounding decides between them.
    aside = exp_se3(rng.normal(size=(2, 1, 6)) * [*[0.1 * meeting.size] * 3, 1.0, 1.0, 1.0])
    T_a, T_b = meeting.T_a, meeting.T_b @ aside
    w, moved = query(meeting.pairs, T_a, T_b), query(meeting.pairs, M @ T_a, M @ T_b)
    turned = np.concatenate([c[..., 3 * k : 3 * k + 3] @ R.T for k in range(3)] + [c[..., 9:]], axis=-1)
    away = np.abs(moved.point_a - w.point_a @ R.T).max() + meeting.size * np.abs(moved.normal - w.normal @ R.T).max()
    if away > 1e-10 * meeting.size or (moved.winner != w.winner).any():
        return  # parallel faces: other points are as good
    layer = WitnessLayer(meeting.pairs, METHODS[name])
    one, two = gradients(layer, (T_a, T_b), c), gradients(layer, (M @ T_a, M @ T_b), turned)
    poses = np.stack([T_a, T_b]), np.stack([M @ T_a, M @ T_b])
    one, two = (body_gradient(T, G) for T, G in zip(poses, (one, two), strict=True))
    assert np.isfinite(one).all()
    # Finite differences are as exact as distances over their steps.
    tolerance = 1e-3 if name == "finite difference" else 1e-6
    np.testing.assert_allclose(two, one, rtol=0, atol=tolerance * np.abs(one).max())
