"""Equilibrium of a grasp as a term of least squares: forces that balance, solved anew at each configuration.

The residual of a grasp is that of the best contact forces, a small quadratic program of its own (`wrench`). Its value
is differentiated at the forces that solve it (Danskin 1967), with contact points and normals sliding on both surfaces
(`witness.contact_kinematics`); the change of the forces while the hand moves makes the residual softer: what they can
balance within the active constraints counts almost nothing (variable projection, Golub and Pereyra 1973).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float

from grasp_refine.collision.query import Witness
from grasp_refine.core.profiling import stage
from grasp_refine.core.se3 import cross, hat, matvec
from grasp_refine.forces.programs import MAX_PRESSURE_SHARE, pyramid_faces
from grasp_refine.forces.wrench import (
    LEVER_M,
    PLANNING_FRICTION,
    RIDGE,
    basis_spin,
    contact_forces_under,
    grasp_map,
    turn_loads,
)
from grasp_refine.hands.chain import Chain, Frames
from grasp_refine.hands.hand import Hand
from grasp_refine.witness.contact_kinematics import contact_slip_jacobian

COUPLING_LEVER_M = 0.06
"""Lever in metres: a torque that the joints of one actuator cannot share counts like the force making it there."""

ACTIVE_TOLERANCE = 1e-7
"""Tolerance, per unit of total pressure, within which a constraint on forces is active."""

PUSH_SHARE = 0.2
"""Outer force that contacts should balance too, per unit of total pressure."""

LOADS = np.concatenate(
    [PUSH_SHARE / np.sqrt(3.0) * np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]), np.zeros((4, 3))], 1
)
"""Loads (4, 6) under which forces should balance, in the axes of a grasp: pushes to the corners of a tetrahedron.

Their mean is no load: what is balanced under all of them is balanced without any, too."""

UNSOLVED_VALUE = 1.0
"""Value of a grasp without contacts, or whose quadratic program is not solved: that of a single contact."""


@dataclass(frozen=True, eq=False)
class Balance:
    """The best contact forces of M grasps under each of P loads, over L links, and what remains unbalanced."""

    unbalanced: np.ndarray
    """[F, tau / `LEVER_M`] with the load, then the torques that no actuator can make (M, P, 6 + E)."""
    force: np.ndarray
    """Force of each link on the object (M, P, L, 3), world frame."""
    local: np.ndarray
    """Force of each link along the normal and its tangents (M, P, L, 3)."""
    solved: np.ndarray
    """True where the forces were found (M, P)."""

    @property
    def pressed(self) -> Bool[np.ndarray, "M L"]:
        """Mask (M, L) of the links that press under any of the loads; derivatives leave out the others."""
        return np.any(self.local[..., 0] > 0, axis=1)

    @property
    def value(self) -> Float[np.ndarray, " M"]:
        """Mean over the loads of the squares of the unbalanced part and, times `RIDGE`, of the forces (M,)."""
        squares = (self.unbalanced**2).sum(axis=-1) + RIDGE * (self.local**2).sum(axis=(-2, -1))
        return np.where(self.solved, squares, UNSOLVED_VALUE).mean(axis=1)


@dataclass(frozen=True, eq=False)
class Equilibrium:
    """The best contact forces of grasps on one object, and the derivative of their unbalanced part as the hand moves.

    Torques of joints that share an actuator (`Hand.coupled`) should be in its ratio: the deviation is unbalanced too.
    """

    chain: Chain
    """Kinematics of the links whose contacts count."""
    center: Float[np.ndarray, " 3"]
    """The object's centre of mass, world frame."""
    forms: Float[np.ndarray, "E m"]
    """Combinations of the chain's joint torques, in N m, that the actuators cannot make, over `COUPLING_LEVER_M`."""
    loads: Float[np.ndarray, "P 6"]
    """Outer loads on the object in the axes of each grasp, otherwise as for `contact_forces`."""
    friction: float = PLANNING_FRICTION
    """Coefficient of sliding friction of all contacts."""

    @staticmethod
    def of(hand: Hand, chain: Chain, center: np.ndarray, friction: float = PLANNING_FRICTION) -> Equilibrium:
        """Return the equilibrium of a hand's grasps."""
        return Equilibrium(chain, center, _infeasible_torques(hand, chain) / COUPLING_LEVER_M, LOADS, friction)

    @stage("forces")
    def forces(
        self,
        touching: Bool[np.ndarray, "M L"],
        witness: Witness,
        frames: Frames,
        axes: Float[np.ndarray, "M 3 3"],
        last: Balance | None = None,
    ) -> Balance:
        """The best forces of the links that touch, over the columns of all links.

        Args:
            touching: Mask (M, L) of the links that push.
            witness: Witness points of all links and the object, world frame.
            frames: Poses of the links.
            axes: Rotations of the grasps' frames, in which loads are, and to which friction pyramids are aligned; they
                rest while the hand moves.
            last: Those of the same grasps nearby, to start from.
        """
        there = (touching & witness.valid)[..., None]
        point, normal = (np.where(there, side, np.nan) for side in (witness.point_b, witness.normal))
        forms = self.torque_forms(np.where(there, witness.point_b, 0.0), frames)
        start = None if last is None else last.local
        found = contact_forces_under(
            turn_loads(self.loads, axes),
            point,
            normal,
            self.center,
            friction=self.friction,
            forms=forms,
            axes=axes,
            start=start,
        )
        return Balance(found.unbalanced, found.force, found.local, found.solved)

    def rows(
        self,
        balance: Balance,
        columns: np.ndarray,
        witness: Witness,
        frames: Frames,
        axes: Float[np.ndarray, "M 3 3"],
        E: np.ndarray,
        K_link: np.ndarray,
        K_object: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Residuals (M, P (6 + E)) and their derivative (..., 6 + n) in root twist and joint values.

        Args:
            balance: Result of `forces`.
            columns: The links (C,) that push in any of the grasps.
            witness: Witness points of these (M, C).
            frames: Poses of the links.
            axes: As for `forces`.
            E: Tangents (M, C, 3, 2) at the normals.
            K_link: Curvatures (M, C, 2, 2) of the links in that basis, 1/m.
            K_object: Curvatures of the object.
        """
        M, C = witness.distance.shape
        P = len(self.loads)
        local, f = balance.local[:, :, columns], balance.force[:, :, columns]
        there = (witness.valid & balance.pressed[:, columns])[..., None]
        p, n = (np.where(there, side, fill) for side, fill in ((witness.point_b, 0.0), (witness.normal, [0, 0, 1.0])))
        motion = np.where(there[..., None], _contact_motion(witness, E, K_link, K_object, n, axes), 0.0)
        motion = self.chain.to_joint_space(frames, motion.reshape(M, C * 6, 6), np.repeat(columns, 6))
        # What is unbalanced is a . f, summed over the contacts, with forms a of forces at points x: da = b x dx.
        twists = self._twist_forms(frames, columns)
        forms = _at(twists, p)
        eye, arm = np.zeros((2, M, 3, C, 3))
        eye[:] = np.eye(3)[:, None]
        arm[:] = ((p - self.center) / LEVER_M)[:, None]
        a = np.concatenate([eye, cross(eye, arm), forms], axis=1)
        b = np.concatenate([np.zeros_like(eye), eye / LEVER_M, twists[..., 3:]], axis=1)
        # Forces turn with their basis, df = Omega x f: d(a . f) = (f x a) . Omega + (f x b) . dx.
        covector = cross(np.stack([f, f], axis=-2)[:, :, None], np.stack([a, b], axis=-2)[:, None])
        J = (covector.reshape(M, -1, C * 6) @ motion).reshape(M, P, a.shape[1], -1)
        if len(self.forms):
            J[:, :, 6:] += self._axis_changes(frames, columns, p, f)
        G, _ = grasp_map(np.where(there, p, np.nan), n, self.center, forms, axes)
        # With K = L L^T, residuals L^T u and rows L^-1 J have the squares u^T K u and the gradient J^T u.
        L = np.linalg.cholesky(np.eye(G.shape[2]) + self._compliance(G, local) / RIDGE)
        residual = matvec(L.mT, balance.unbalanced)
        stiff = np.linalg.inv(L) @ J
        solved = balance.solved[..., None]
        residual, stiff = np.where(solved, residual, 0.0), np.where(solved[..., None], stiff, 0.0)
        share = 1.0 / np.sqrt(P)
        return share * residual.reshape(M, -1), share * stiff.reshape(M, residual.shape[1] * residual.shape[2], -1)

    def torque_forms(self, p: Float[np.ndarray, "M L 3"], frames: Frames) -> Float[np.ndarray, "M E L 3"] | None:
        """Torques that no actuator can make, as linear forms of forces at points of links; None: actuators make all.

        Args:
            p: Points of all links (M, L, 3), world frame.
            frames: Poses of the links.
        """
        if not len(self.forms):
            return None
        return _at(self._twist_forms(frames, np.arange(p.shape[1])), p)

    def _twist_forms(self, frames: Frames, columns: np.ndarray) -> Float[np.ndarray, "M E C 6"]:
        """Twists of the links (C,) whose products with wrenches on these are the torques that no actuator can make."""
        axes = frames.axes[..., 6:].mT
        weight = self.forms[:, None] * self.chain.joint_mask(columns)[:, 6:]
        E, C, m = weight.shape
        return (weight.reshape(E * C, m) @ axes).reshape(len(axes), E, C, 6)

    def _axis_changes(self, frames: Frames, columns: np.ndarray, p: np.ndarray, f: np.ndarray) -> np.ndarray:
        """Derivative (M, P, E, 6 + n) of these torques as the axes of the joints move, while the forces rest."""
        (M, P), chain = f.shape[:2], self.chain
        used = np.flatnonzero(self.forms.any(axis=0))
        follows = chain.joint_mask(columns)[:, 6 + used]
        linear, angular = np.split(frames.axes[..., 6 + used].mT[:, None], 2, axis=-1)
        W = np.concatenate([f, cross(p[:, None] + np.zeros_like(f), f)], axis=-1)
        force, moment = np.split(follows.T @ W, 2, axis=-1)
        linear, angular = (part + np.zeros_like(force) for part in (linear, angular))
        # An axis S moves with its link: d(S . W) = (angular x f) . v + (linear x f + angular x m) . w.
        turned = cross(linear, force) + cross(angular, moment)
        by_axis = np.concatenate([cross(angular, force), turned], axis=-1).reshape(M, P * len(used), 6)
        by_axis = chain.to_joint_space(frames, by_axis, np.tile(len(chain.links) + used, P))
        return self.forms[:, used] @ by_axis.reshape(M, P, len(used), -1)

    def _compliance(self, G: np.ndarray, local: np.ndarray) -> np.ndarray:
        """Compliance G N G^T (M, P, R, R) of the forces: N projects onto changes that keep the active constraints."""
        faces, projectors = self._free_changes
        held = local @ faces.T > -ACTIVE_TOLERANCE
        pressure = local[..., 0]
        case = np.packbits(held, axis=-1)[..., 0] + 256 * (pressure > MAX_PRESSURE_SHARE - ACTIVE_TOLERANCE)
        N = projectors[np.where(pressure > ACTIVE_TOLERANCE, case, -1)]
        M, P, C = local.shape[:3]
        R = G.shape[2]
        free = np.moveaxis(G[:, None] @ N, 2, 3).reshape(M, P, R, 3 * C)
        along = N[..., 0].reshape(M, P, 3 * C, 1)
        # The pressures sum to 1.
        length, lost = (along * along).sum(axis=(-2, -1))[..., None, None], free @ along
        scale = np.where(length > 1e-9, 1.0 / np.where(length > 1e-9, length, 1.0), 0.0)
        return free @ free.mT - scale * (lost @ lost.mT)

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


def _at(twists: np.ndarray, p: np.ndarray) -> np.ndarray:
    """Velocities (M, E, C, 3) at points (M, C, 3) of links with twists (M, E, C, 6)."""
    linear, angular = np.split(twists, 2, axis=-1)
    return linear + cross(angular, p[:, None] + np.zeros_like(angular))


def _contact_motion(
    witness: Witness, E: np.ndarray, K_link: np.ndarray, K_object: np.ndarray, n: np.ndarray, axes: np.ndarray
) -> Float[np.ndarray, "M C 6 6"]:
    """Rotations of the contacts' local bases, then movements of their points, in the twists of the links.

    The bases are those of `basis_tangents`; they turn by n x dn and about the normal.
    """
    distance = np.where(witness.valid, witness.distance, 0.0)
    U_link, U_object = contact_slip_jacobian(witness.point_b, witness.normal, distance, E, K_link, K_object)
    normal = -(E @ (K_link @ U_link))
    # dn = w x n while the link's surface is flat.
    normal[..., 3:] -= hat(n)
    turn = hat(n) @ normal + n[..., :, None] * basis_spin(n, normal, axes)[..., None, :]
    return np.concatenate([turn, -(E @ U_object)], axis=-2)


def _infeasible_torques(hand: Hand, chain: Chain) -> Float[np.ndarray, "E m"]:
    """Unit combinations of torques that no actuator can make, as forms of those of the chain's joints."""
    rows = [np.zeros((0, len(hand.joint_names)))]
    for group in hand.coupled:
        # An orthonormal basis of what is perpendicular to the ratio.
        _, _, basis = np.linalg.svd(np.array(group.ratio, dtype=np.float64)[None])
        row = np.zeros((len(group.joints) - 1, len(hand.joint_names)))
        row[:, [hand.joint_names.index(name) for name in group.joints]] = basis[1:]
        rows.append(row)
    return np.concatenate(rows) @ chain.joint_gains.T
