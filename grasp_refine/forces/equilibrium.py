"""Equilibrium of a grasp as a term of least squares: forces that balance, solved anew at each configuration.

The residual of a grasp is the residual of the best contact forces, a small quadratic program of its own (`wrench`).
Its value is differentiated at the forces that solve it (Danskin 1967), with contact points and normals sliding on both
surfaces (`witness.contact_kinematics`); the change of the forces while the hand moves makes the residual softer: what
they can balance within the active constraints counts almost nothing (variable projection, Golub and Pereyra 1973).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from grasp_refine.collision.engine import chosen
from grasp_refine.collision.query import Witness
from grasp_refine.core.array_records import take
from grasp_refine.core.array_types import Bool, Float
from grasp_refine.core.profiling import stage
from grasp_refine.core.se3 import cross, hat, matvec
from grasp_refine.forces.contact_points import SLOTS, ContactPoints, LinkPatches, patches_columns
from grasp_refine.forces.infeasible_torques import InfeasibleTorques, velocities
from grasp_refine.forces.programs import MAX_PRESSURE_SHARE, SHARE_TOLERANCE, heaviest_link, pyramid_faces
from grasp_refine.forces.wrench import (
    LEVER_M,
    PLANNING_FRICTION,
    RIDGE,
    basis_spin,
    grasp_map,
    turn_loads,
)
from grasp_refine.hands.chain import Chain, Frames
from grasp_refine.hands.hand import Hand
from grasp_refine.objects.object import Object
from grasp_refine.witness.contact_kinematics import contact_slip_jacobian
from grasp_refine.witness.face_patch import NUM_CORNERS

ACTIVE_TOLERANCE = 1e-7
"""Tolerance, per unit of total pressure, within which a constraint on forces is active."""

PUSH_SHARE = 0.2
"""Outer force that contacts should balance too, per unit of total pressure."""

LOADS = np.concatenate(
    [PUSH_SHARE / np.sqrt(3.0) * np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]), np.zeros((4, 3))], 1
)
"""Loads (4, 6) under which forces should balance, in the axes of a grasp: pushes to the corners of a tetrahedron.

Their mean is no load: a grasp balanced under all of them is balanced without any, too."""

UNSOLVED_VALUE = 1.0
"""Value of a grasp without contacts, or whose quadratic program is not solved: the value of a single contact."""


@dataclass(frozen=True, eq=False)
class Balance:
    """The best contact forces of M grasps under each of P loads, over L links, and the unbalanced wrench."""

    unbalanced: np.ndarray
    """[F, tau / `LEVER_M`] with the load, then the torques that the hand cannot make (M, P, 6 + E)."""
    force: np.ndarray
    """Force on the object at each contact point (M, P, K, 3), columns as in `ContactPoints`, world frame."""
    local: np.ndarray
    """Force at each contact point along the normal and its tangents (M, P, K, 3)."""
    solved: np.ndarray
    """True where the forces were found (M, P)."""
    value: np.ndarray
    """Mean over the loads of the squares of the unbalanced part and, times `RIDGE`, of the forces (M,)."""

    @property
    def pressed(self) -> Bool[np.ndarray, "M K"]:
        """Mask (M, K) of the points that press under any of the loads; derivatives leave out the others."""
        return np.any(self.local[..., 0] > 0, axis=1)


@dataclass(frozen=True, eq=False)
class Equilibrium:
    """The best contact forces of grasps, and how their unbalanced part changes as the hand moves."""

    chain: Chain
    """Kinematics of the links whose contacts count."""
    infeasible: InfeasibleTorques
    """Torques that the hand cannot make, which are unbalanced too."""
    loads: Float[np.ndarray, "P 6"]
    """Outer loads on the object in the axes of each grasp, otherwise as for `contact_forces`."""
    friction: float = PLANNING_FRICTION
    """Coefficient of sliding friction of all contacts."""

    @staticmethod
    def of(hand: Hand, chain: Chain, friction: float = PLANNING_FRICTION) -> Equilibrium:
        """Return the equilibrium of a hand's grasps."""
        return Equilibrium(chain, InfeasibleTorques.of(hand, chain), LOADS, friction)

    @stage("forces")
    def forces(
        self,
        touching: Bool[np.ndarray, "M L"],
        witness: Witness,
        frames: Frames,
        center: Float[np.ndarray, "M 3"],
        axes: Float[np.ndarray, "M 3 3"],
        last: Balance | None = None,
        patches: LinkPatches | None = None,
    ) -> Balance:
        """The best forces of the links that touch, over the columns of all links.

        Args:
            touching: Mask (M, L) of the links that push.
            witness: Witness points of all links and the object, world frame.
            frames: Poses of the links.
            center: Centre of mass (M, 3) of each grasp's object, world frame.
            axes: Rotations of the grasps' frames, in which loads are, and to which friction pyramids are aligned; they
                rest while the hand moves.
            last: Solutions of the same grasps nearby, to start from.
            patches: Patches of the links, with forces at their corners; None: where no link can have any.
        """
        if patches is not None and not touching.all():
            patches = patches.restricted(touching)
        points = ContactPoints.of(touching, witness, patches)
        found = points.forces_under(
            turn_loads(self.loads, axes),
            center,
            axes=axes,
            friction=self.friction,
            forms=self.forms_at(frames),
            start=None if last is None else last.local,
        )
        squares = (found.unbalanced**2).sum(axis=-1) + RIDGE * found.squares
        value = np.where(found.solved, squares, UNSOLVED_VALUE).mean(axis=1)
        return Balance(found.unbalanced, found.force, found.local, found.solved, value)

    def rows(
        self,
        balance: Balance,
        columns: np.ndarray,
        witness: Witness,
        frames: Frames,
        center: Float[np.ndarray, "M 3"],
        axes: Float[np.ndarray, "M 3 3"],
        E: np.ndarray,
        K_link: np.ndarray,
        K_object: np.ndarray,
        patches: LinkPatches | None = None,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Residuals (M, P (6 + E)) and their derivative (..., 6 + n) in root twist and joint values.

        Args:
            balance: Result of `forces`.
            columns: The links (C,) that push in any of the grasps.
            witness: Witness points of these (M, C).
            frames: Poses of the links.
            center: As for `forces`.
            axes: As for `forces`.
            E: Tangents (M, C, 3, 2) at the normals.
            K_link: Curvatures (M, C, 2, 2) of the links in that basis, 1/m.
            K_object: Curvatures of the object.
            patches: As for `forces`.
        """
        pressed = balance.pressed
        there = (witness.valid & pressed[:, columns])[..., None]
        p, n = (np.where(there, side, fill) for side, fill in ((witness.point_b, 0.0), (witness.normal, [0, 0, 1.0])))
        motion = np.where(there[..., None], _contact_motion(witness, E, K_link, K_object, n, axes), 0.0)
        f, local = balance.force[:, :, columns], balance.local[:, :, columns]
        moving = _Moving(p, n, motion, there[..., 0], np.broadcast_to(columns, p.shape[:2]), f, local)
        patched = np.zeros(len(p), dtype=bool) if patches is None else patches.faces.count.any(axis=1)
        if patches is None or not patched.any():
            return self._rows(balance, moving, frames, center, axes, shared=False)
        plain, flat = np.flatnonzero(~patched), np.flatnonzero(patched)
        corners = _with_corners(take(moving, flat), columns, take(patches, flat), take(balance, flat))
        residual, J = self._rows(
            take(balance, flat), corners, take(frames, flat), center[flat], axes[flat], shared=True
        )
        every = np.empty((len(p), *residual.shape[1:])), np.empty((len(p), *J.shape[1:]))
        for array, part in zip(every, (residual, J), strict=True):
            array[flat] = part
        if len(plain):
            few = take(balance, plain), take(moving, plain), take(frames, plain), center[plain], axes[plain]
            parts = self._rows(*few, shared=False)
            for array, part in zip(every, parts, strict=True):
                array[plain] = part
        return every

    def _rows(
        self,
        balance: Balance,
        moving: _Moving,
        frames: Frames,
        center: np.ndarray,
        axes: np.ndarray,
        *,
        shared: bool,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Residuals and their derivative, as `rows`, at points that move with links, (C,) or (M, C).

        `shared`: whether points of one link share its largest pressure.
        """
        moving = moving.pressing()
        p, n, f, local, link = moving.point, moving.normal, moving.force, moving.local, moving.links
        (M, C), P = p.shape[:2], len(self.loads)
        motion = self.chain.to_joint_space(frames, moving.motion.reshape(M, C * 6, 6), np.repeat(link, 6, axis=-1))
        # What is unbalanced is a . f, summed over the contacts, with forms a of forces at points x: da = b x dx.
        twists = self.infeasible.twists(frames, link)
        forms = velocities(twists, p)
        eye, arm = np.zeros((2, M, 3, C, 3))
        eye[:] = np.eye(3)[:, None]
        arm[:] = ((p - center[:, None]) / LEVER_M)[:, None]
        a = np.concatenate([eye, cross(eye, arm), forms], axis=1)
        b = np.concatenate([np.zeros_like(eye), eye / LEVER_M, twists[..., 3:]], axis=1)
        # Forces turn with their basis, df = Omega x f: d(a . f) = (f x a) . Omega + (f x b) . dx.
        covector = cross(np.stack([f, f], axis=-2)[:, :, None], np.stack([a, b], axis=-2)[:, None])
        J = _products(covector.reshape(M, -1, C * 6), motion).reshape(M, P, a.shape[1], -1)
        if len(self.infeasible):
            J[:, :, 6:] += self.infeasible.changes(frames, link, p, f)
        G, _ = grasp_map(np.where(moving.there[..., None], p, np.nan), n, center, forms, axes)
        # With K = L L^T, residuals L^T u and rows L^-1 J have the squares u^T K u and the gradient J^T u.
        L = np.linalg.cholesky(np.eye(G.shape[2]) + self._compliance(G, local, link if shared else None) / RIDGE)
        residual = matvec(L.mT, balance.unbalanced)
        stiff = np.linalg.inv(L) @ J
        solved = balance.solved[..., None]
        residual, stiff = np.where(solved, residual, 0.0), np.where(solved[..., None], stiff, 0.0)
        share = 1.0 / np.sqrt(P)
        return share * residual.reshape(M, -1), share * stiff.reshape(M, residual.shape[1] * residual.shape[2], -1)

    def forms_at(self, frames: Frames) -> Callable[[np.ndarray | slice, ContactPoints], np.ndarray | None]:
        """Return the function from grasps and their contact points to the torques that the hand cannot make."""

        def forms(rows: np.ndarray | slice, points: ContactPoints) -> np.ndarray | None:
            link = None if points.patches is None else points.link
            return self.infeasible.forms(take(frames, rows), np.nan_to_num(points.point), link)

        return forms

    def _compliance(self, G: np.ndarray, local: np.ndarray, link: np.ndarray | None) -> np.ndarray:
        """Compliance G N G^T (M, P, R, R) of the forces: N projects onto changes that keep the active constraints.

        Links (M, C): where their points share the largest pressure.
        """
        faces, projectors = self._free_changes
        held = local @ faces.T > -ACTIVE_TOLERANCE
        pressure = local[..., 0]
        case = np.packbits(held, axis=-1)[..., 0] + 256 * (pressure > MAX_PRESSURE_SHARE - ACTIVE_TOLERANCE)
        N = projectors[np.where(pressure > ACTIVE_TOLERANCE, case, -1)]
        M, P, C = local.shape[:3]
        R = G.shape[2]
        free = np.moveaxis(G[:, None] @ N, 2, 3).reshape(M, P, R, 3 * C)
        # The pressures sum to 1; the pressures of the most loaded link sum to that load.
        sums = [N[..., 0]]
        if link is not None:
            most, excess = heaviest_link(local, link[:, None])
            part = N[..., 0] * (most & (excess > -SHARE_TOLERANCE)[..., None])[..., None]
            sums = [part, sums[0] - part]
        compliance = _products(free, free.mT)
        for along in (part.reshape(M, P, 3 * C, 1) for part in sums):
            length, lost = _products(along.mT, along), _products(free, along)
            scale = np.where(length > 1e-9, 1.0 / np.where(length > 1e-9, length, 1.0), 0.0)
            compliance = compliance - scale * (lost @ lost.mT)
        return compliance

    @cached_property
    def _free_changes(self) -> tuple[Float[np.ndarray, "8 3"], Float[np.ndarray, "513 3 3"]]:
        """Normals of a pyramid's faces, and projectors onto the changes of a force that keep its active constraints.

        Projectors are numbered by the faces that hold the force, as the bits of a byte, plus 256 at the cap; the last
        one is 0.
        """
        faces = pyramid_faces(self.friction)
        held = np.unpackbits(np.arange(256, dtype=np.uint8)[:, None], axis=1)
        squares = (held[:, None] * faces.T) @ faces
        values, vectors = np.linalg.eigh(np.concatenate([squares, squares + np.diag([1.0, 0.0, 0.0])]))
        projectors = (vectors * (values < 1e-6)[:, None]) @ vectors.mT
        return faces, np.concatenate([projectors, np.zeros((1, 3, 3))])


def _products(A: np.ndarray, B: np.ndarray) -> np.ndarray:
    """Return products of matrices in which zeros of contacts that only other grasps have change no bit."""
    if chosen("auto") == "python":
        return A @ B
    from grasp_refine.collision.native_search import products

    return products(A, B)


@dataclass(frozen=True, eq=False)
class _Moving:
    """C contact points of each of M grasps that move with the links."""

    point: np.ndarray
    """Points (M, C, 3); 0 where there is none."""
    normal: np.ndarray
    """Normals (M, C, 3)."""
    motion: np.ndarray
    """Rotations of the local bases, then movements of the points, in the twists of the links (M, C, 6, 6)."""
    there: np.ndarray
    """Mask (M, C) of the points that press."""
    links: np.ndarray
    """Links (M, C) of the points."""
    force: np.ndarray
    """Forces (M, P, C, 3)."""
    local: np.ndarray
    """Forces along the normal and its tangents (M, P, C, 3)."""

    def pressing(self) -> _Moving:
        """Return the points that press, first, and as few others as all grasps need: these have no force."""
        place = np.argsort(~self.there, axis=1, kind="stable")[:, : int(self.there.sum(axis=1).max(initial=0))]
        row = np.arange(len(place))[:, None]
        by_point = self.point, self.normal, self.motion, self.there, self.links
        loads = row[..., None], np.arange(self.force.shape[1])[:, None], place[:, None]
        return _Moving(*(one[row, place] for one in by_point), *(one[loads] for one in (self.force, self.local)))


def _with_corners(moving: _Moving, columns: np.ndarray, patches: LinkPatches, balance: Balance) -> _Moving:
    """Contact points with the corners of patches, which take the columns of their links and some behind them.

    The bases at corners rest: the normal is the normal of the object's face.
    """
    M, C = moving.there.shape
    extra = SLOTS * (NUM_CORNERS - 1)
    L = balance.local.shape[2] - extra

    def padded(values: np.ndarray, fill: float = 0.0) -> np.ndarray:
        return np.concatenate([values, np.full((M, extra, *values.shape[2:]), fill)], axis=1)

    point, normal, motion = (padded(part) for part in (moving.point, moving.normal, moving.motion))
    normal[:, C:, 2] = 1.0
    there = np.concatenate([moving.there, np.zeros((M, extra), dtype=bool)], axis=1)
    row, slot, corner, column = patches_columns(patches, L)
    place = np.where(column < L, np.searchsorted(columns, column), C + column - L)
    faces = patches.faces
    presses = balance.pressed[row, column]
    point[row, place] = np.where(presses[:, None], faces.point[row, slot, corner], 0.0)
    normal[row, place] = faces.normal[row, slot]
    motion[row, place, :3] = 0.0
    motion[row, place, 3:] = np.where(presses[:, None, None], faces.motion[row, slot, corner], 0.0)
    there[row, place] = presses
    links = np.concatenate([moving.links, np.repeat(np.maximum(patches.link, 0), NUM_CORNERS - 1, axis=1)], axis=1)
    both = np.concatenate([columns, np.arange(L, L + extra)])
    return _Moving(point, normal, motion, there, links, balance.force[:, :, both], balance.local[:, :, both])


def _contact_motion(
    witness: Witness, E: np.ndarray, K_link: np.ndarray, K_object: np.ndarray, n: np.ndarray, axes: np.ndarray
) -> Float[np.ndarray, "M C 6 6"]:
    """Rotations of the contacts' local bases, then movements of their points, in the twists of the links.

    The bases are from `basis_tangents`; they turn by n x dn and about the normal.
    """
    distance = np.where(witness.valid, witness.distance, 0.0)
    U_link, U_object = contact_slip_jacobian(witness.point_b, witness.normal, distance, E, K_link, K_object)
    normal = -(E @ (K_link @ U_link))
    # dn = w x n while the link's surface is flat.
    normal[..., 3:] -= hat(n)
    turn = hat(n) @ normal + n[..., :, None] * basis_spin(n, normal, axes)[..., None, :]
    return np.concatenate([turn, -(E @ U_object)], axis=-2)


def mode_residual(
    hand: Hand, obj: Object, chain: Chain, frames: Frames, points: ContactPoints, grip: float = 1.0
) -> Float[np.ndarray, " N"]:
    """Return the largest torque (N,) in a mode of a linkage that the best forces of grasps leave, without unit.

    It is per unit of total pressure, over `infeasible_torques.LEVER_M`; `grip` is that of the task's `Demand`.
    """
    equilibrium = Equilibrium.of(hand, chain, PLANNING_FRICTION * grip)
    none, axes = np.zeros((len(frames.q), 1, 6)), frames.T_world_root[:, :3, :3]
    found = points.forces_under(
        none, obj.center_of_mass, friction=equilibrium.friction, forms=equilibrium.forms_at(frames), axes=axes
    )
    return np.abs(found.unbalanced[:, 0, -len(hand.modes) :]).max(axis=1)
