"""Equilibrium of a grasp as a term of least squares: forces that balance, solved anew at each configuration.

The residual of a grasp is that of the best contact forces, a small quadratic program of its own (`wrench`). Its value
is differentiated at the forces that solve it (Danskin 1967), with contact points and normals sliding on both surfaces
(`witness.contact_kinematics`); the change of the forces while the hand moves makes the residual softer: what they can
balance within the active constraints counts almost nothing (variable projection, Golub and Pereyra 1973).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from grasp_refine.collision.query import Witness
from grasp_refine.core.profiling import stage
from grasp_refine.core.se3 import cross, hat, matvec
from grasp_refine.forces.programs import MAX_PRESSURE_SHARE, NUM_EDGES
from grasp_refine.forces.wrench import (
    LEVER_M,
    PLANNING_FRICTION,
    RIDGE,
    basis_spin,
    contact_forces_under,
    grasp_map,
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
"""Loads (4, 6) under which forces should balance: pushes to the corners of a tetrahedron.

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
    """Outer loads on the object, as for `contact_forces`."""
    friction: float = PLANNING_FRICTION
    """Coefficient of sliding friction of all contacts."""

    @staticmethod
    def of(hand: Hand, chain: Chain, center: np.ndarray, friction: float = PLANNING_FRICTION) -> Equilibrium:
        """Return the equilibrium of a hand's grasps."""
        return Equilibrium(chain, center, _infeasible_torques(hand, chain) / COUPLING_LEVER_M, LOADS, friction)

    @stage("forces")
    def forces(self, touching: Bool[np.ndarray, "M L"], witness: Witness, frames: Frames) -> Balance:
        """The best forces of the links that touch, over the columns of all links.

        Args:
            touching: Mask (M, L) of the links that push.
            witness: Witness points of all links and the object, world frame.
            frames: Poses of the links.
        """
        there = (touching & witness.valid)[..., None]
        point, normal = (np.where(there, side, np.nan) for side in (witness.point_b, witness.normal))
        forms = self.torque_forms(np.where(there, witness.point_b, 0.0), frames)
        found = contact_forces_under(self.loads, point, normal, self.center, friction=self.friction, forms=forms)
        return Balance(found.unbalanced, found.force, found.local, found.solved)

    def rows(
        self,
        balance: Balance,
        columns: np.ndarray,
        witness: Witness,
        frames: Frames,
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
            E: Tangents (M, C, 3, 2) at the normals.
            K_link: Curvatures (M, C, 2, 2) of the links in that basis, 1/m.
            K_object: Curvatures of the object.
        """
        M, C = witness.distance.shape
        P = len(self.loads)
        local, f = balance.local[:, :, columns], balance.force[:, :, columns]
        there = (witness.valid & balance.pressed[:, columns])[..., None]
        p, n = (np.where(there, side, fill) for side, fill in ((witness.point_b, 0.0), (witness.normal, [0, 0, 1.0])))
        sliding = (np.where(there[..., None], part, 0.0) for part in _contact_motion(witness, E, K_link, K_object, n))
        point, turn = (part[:, None] for part in sliding)
        # df = Omega x f, d(r x f) = dr x f + r x df
        force = -hat(f) @ turn
        moment = hat(p - self.center)[:, None] @ force - hat(f) @ point
        covector = np.concatenate([force, moment / LEVER_M], axis=-2).reshape(M, P * C * 6, 6)
        J = (
            self.chain.to_joint_space(frames, covector, np.tile(np.repeat(columns, 6), P))
            .reshape(M, P, C, 6, -1)
            .sum(axis=2)
        )
        if len(self.forms):
            changed = np.concatenate([force, hat(p)[:, None] @ force - hat(f) @ point], axis=-2)
            J = np.concatenate([J, self._torque_rows(frames, columns, p, f, changed)], axis=2)
        G, _ = grasp_map(np.where(there, p, np.nan), n, self.center, self.torque_forms(p, frames, columns))
        values, vectors = np.linalg.eigh(_compliance(G, local, self.friction))
        root = np.sqrt(1.0 + np.maximum(values, 0.0) / RIDGE)[..., None, :]
        share = 1.0 / np.sqrt(P)
        residual = matvec((vectors * root) @ vectors.mT, balance.unbalanced)
        stiff = (vectors / root) @ vectors.mT @ J
        solved = balance.solved[..., None]
        residual, stiff = np.where(solved, residual, 0.0), np.where(solved[..., None], stiff, 0.0)
        return share * residual.reshape(M, -1), share * stiff.reshape(M, residual.shape[1] * residual.shape[2], -1)

    def torque_forms(
        self, p: Float[np.ndarray, "M C 3"], frames: Frames, columns: np.ndarray | None = None
    ) -> Float[np.ndarray, "M E C 3"] | None:
        """Torques that no actuator can make, as linear forms of forces at points of links; None: actuators make all.

        Args:
            p: Points (M, C, 3), world frame.
            frames: Poses of the links.
            columns: The links (C,); None: all.
        """
        if not len(self.forms):
            return None
        links = np.arange(p.shape[1]) if columns is None else columns
        axes = frames.axes[..., 6:]
        # Velocity of each point per joint.
        velocity = axes[:, None, :3] - hat(p) @ axes[:, None, 3:]
        velocity = velocity * self.chain.joint_mask(links)[:, None, 6:]
        return np.einsum("ej,mcij->meci", self.forms, velocity)

    def _torque_rows(
        self, frames: Frames, columns: np.ndarray, p: np.ndarray, f: np.ndarray, changed: np.ndarray
    ) -> np.ndarray:
        """Derivative (M, P, E, 6 + n) of the combinations of torques, S . W summed over the forces' wrenches W.

        `changed` is that of the wrenches W = (f, p x f) about the world's origin, in the twists of the links.
        """
        chain, m = self.chain, len(self.chain.joints)
        M, P, C = f.shape[:3]
        S = frames.axes[..., 6:].mT
        follows = chain.joint_mask(columns)[:, 6:]
        W = np.concatenate([f, np.cross(p[:, None], f)], axis=-1)
        force, moment = np.split((follows.T @ W).reshape(M, P, m, 6), 2, axis=-1)
        linear, angular = S[:, None, :, :3], S[:, None, :, 3:]
        # An axis moves with its link: d(S . W) = (angular x f) . v + (linear x f + angular x m) . w.
        turned = np.cross(linear, force) + np.cross(angular, moment)
        by_axis = np.concatenate([np.cross(angular, force), turned], axis=-1)
        carried = np.tile(len(chain.links) + np.arange(m), P)
        by_axes = chain.to_joint_space(frames, by_axis.reshape(M, P * m, 6), carried).reshape(M, P, m, -1)
        pulled = chain.to_joint_space(frames, changed.reshape(M, P * C * 6, 6), np.tile(np.repeat(columns, 6), P))
        # sum over contacts c of forms S follows[c] . dW_c
        weight = np.einsum("ej,mjw,cj->mecw", self.forms, S, follows).reshape(M, 1, len(self.forms), C * 6)
        return self.forms @ by_axes + weight @ pulled.reshape(M, P, C * 6, -1)


def _contact_motion(
    witness: Witness, E: np.ndarray, K_link: np.ndarray, K_object: np.ndarray, n: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Derivatives of contact points and rotations of their local bases, both (M, C, 3, 6), in the twists of the links.

    The bases are those of `basis_tangents`; they turn by n x dn and about the normal.
    """
    distance = np.where(witness.valid, witness.distance, 0.0)
    U_link, U_object = contact_slip_jacobian(witness.point_b, witness.normal, distance, E, K_link, K_object)
    eye = np.eye(3) + np.zeros_like(n[..., None])
    turned = np.concatenate([np.zeros_like(eye), cross(n[..., None, :] + np.zeros_like(eye), eye)], axis=-1)
    normal = turned - E @ (K_link @ U_link)
    return -(E @ U_object), hat(n) @ normal + n[..., :, None] * basis_spin(n, normal)[..., None, :]


def _compliance(G: np.ndarray, local: np.ndarray, friction: float) -> np.ndarray:
    """Compliance G N G^T (M, P, R, R) of the forces: N projects onto changes that keep the active constraints."""
    N = _free_changes(local, friction)
    M, P, C = local.shape[:3]
    R = G.shape[2]
    free = np.moveaxis(G[:, None] @ N, 2, 3).reshape(M, P, R, 3 * C)
    along = N[..., 0].reshape(M, P, 3 * C, 1)
    # The pressures sum to 1.
    length, lost = (along * along).sum(axis=(-2, -1))[..., None, None], free @ along
    scale = np.where(length > 1e-9, 1.0 / np.where(length > 1e-9, length, 1.0), 0.0)
    return free @ free.mT - scale * (lost @ lost.mT)


def _free_changes(local: np.ndarray, friction: float) -> np.ndarray:
    """Projectors (..., C, 3, 3) onto the changes of each force that keep its active constraints."""
    angle = (np.arange(NUM_EDGES) + 0.5) * 2.0 * np.pi / NUM_EDGES
    rim = friction * np.cos(np.pi / NUM_EDGES)
    face = np.stack([np.full(NUM_EDGES, -rim), np.cos(angle), np.sin(angle)], axis=1)
    pressure = local[..., 0]
    held = local @ face.T > -ACTIVE_TOLERANCE
    rows = np.where(held[..., None], face, 0.0)
    capped = pressure > MAX_PRESSURE_SHARE - ACTIVE_TOLERANCE
    rows = np.concatenate([rows, np.where(capped[..., None], [1.0, 0.0, 0.0], 0.0)[..., None, :]], axis=-2)
    values, vectors = np.linalg.eigh(rows.mT @ rows)
    kept = (values < 1e-6) & (pressure > ACTIVE_TOLERANCE)[..., None]
    return (vectors * kept[..., None, :]) @ vectors.mT


def _infeasible_torques(hand: Hand, chain: Chain) -> Float[np.ndarray, "E m"]:
    """Unit combinations of torques that no actuator can make, as forms of those of the chain's joints."""
    rows = [np.zeros((0, len(hand.joint_names)))]
    for group in hand.coupled:
        # An orthonormal basis of what is perpendicular to the ratio.
        _, _, basis = np.linalg.svd(np.array(group.ratio, dtype=np.float64)[None])
        row = np.zeros((len(group.joints) - 1, len(hand.joint_names)))
        row[:, [hand.joint_names.index(name) for name in group.joints]] = basis[1:]
        rows.append(row)
    matrix, _, names = hand.mimic_map()
    return np.concatenate(rows) @ matrix[[names.index(name) for name in chain.joints]].T
