"""Equilibrium of a grasp as a term of least squares: forces that balance, found anew wherever the hand is.

The residual of a grasp is that of the best contact forces, a small quadratic program of its own (`wrench`). Its value
is differentiated at the forces that solve it (Danskin 1967), with contact points and normals sliding on both surfaces
(`witness.contact_kinematics`); how the forces give way while the hand moves makes the residual softer: what they can
balance, within the constraints that are active, counts next to nothing (variable projection, Golub and Pereyra 1973).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from grasp_refine.chain import Chain, Frames
from grasp_refine.collision.query import Witness
from grasp_refine.hand import Hand
from grasp_refine.se3 import cross, hat, matvec
from grasp_refine.witness.contact_kinematics import slide
from grasp_refine.wrench import EDGES, LENGTH, MOST, PLANNING_FRICTION, RIDGE, ContactForces, contact_forces, grasp_map

LEVER = 0.06
"""A torque that the joints of one actuator cannot share counts like the force that makes it at this lever, metres."""

ACTIVE = 1e-7
"""A constraint on forces is active where it holds with equality to within this, per unit of total pressure."""

HOPELESS = 1.0
"""Value of a grasp without contacts, or whose program is not solved: that of a single contact."""


@dataclass(frozen=True, eq=False)
class Equilibrium:
    """The best contact forces of grasps on one object, and how what they leave changes as the hand moves.

    Torques of joints that share an actuator (`Hand.coupled`) should be in its ratio: what they lack is unbalanced too.
    """

    chain: Chain
    center: Float[np.ndarray, " 3"]
    """The object's centre of mass, world frame."""
    forms: Float[np.ndarray, "E m"]
    """Combinations of torques (about the chain's joints, in N m) that the actuators cannot make, over `LEVER`."""
    friction: float = PLANNING_FRICTION

    @staticmethod
    def of(hand: Hand, chain: Chain, center: np.ndarray, friction: float = PLANNING_FRICTION) -> Equilibrium:
        """That of a hand's grasps."""
        return Equilibrium(chain, center, _impossible(hand, chain) / LEVER, friction)

    def forces(self, touching: Bool[np.ndarray, "M L"], witness: Witness, frames: Frames) -> ContactForces:
        """The best forces of the links that touch, over the columns of all links.

        Args:
            touching: Which links (M, L) push.
            witness: Witness points of all links and the object, world frame.
            frames: Where the links are.
        """
        there = (touching & witness.valid)[..., None]
        point, normal = (np.where(there, side, np.nan) for side in (witness.point_b, witness.normal))
        forms = self.torque_forms(np.where(there, witness.point_b, 0.0), frames)
        return contact_forces(point, normal, self.center, friction=self.friction, forms=forms)

    @staticmethod
    def value(forces: ContactForces) -> Float[np.ndarray, " M"]:
        """Sum of the squares of what is unbalanced and, times `RIDGE`, of the forces (M,)."""
        squares = (forces.unbalanced**2).sum(axis=1) + RIDGE * (forces.local**2).sum(axis=(1, 2))
        return np.where(forces.solved, squares, HOPELESS)

    def rows(
        self,
        forces: ContactForces,
        columns: np.ndarray,
        witness: Witness,
        frames: Frames,
        E: np.ndarray,
        K_link: np.ndarray,
        K_object: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Residuals (M, 6 + E) and their derivative (M, 6 + E, 6 + n) in root twist and joint values.

        Args:
            forces: What `forces` gave.
            columns: The links (C,) that push in any of the grasps.
            witness: Witness points of these (M, C).
            frames: Where the links are.
            E: Tangents (M, C, 3, 2) at the normals.
            K_link: Curvatures (M, C, 2, 2) of the links in that basis, 1/m.
            K_object: Curvatures of the object.
        """
        M, C = witness.distance.shape
        local = forces.local[:, columns]
        pushing = (local[..., 0] > 0)[..., None]
        p, n = (np.where(pushing, side, fill) for side, fill in ((witness.point_b, 0.0), (witness.normal, [0, 0, 1.0])))
        f = np.where(pushing, forces.force[:, columns], 0.0)
        point, force = (np.where(pushing[..., None], part, 0.0) for part in _carried(witness, E, K_link, K_object, n, f))
        # d(r x f) = dr x f + r x df
        moment = hat(p - self.center) @ force - hat(f) @ point
        covector = np.concatenate([force, moment / LENGTH], axis=-2).reshape(M, C * 6, 6)
        J = self.chain.pull(frames, covector, np.repeat(columns, 6)).reshape(M, C, 6, -1).sum(axis=1)
        if len(self.forms):
            J = np.concatenate([J, self._torque_rows(frames, columns, p, f, point, force)], axis=1)
        forms = self.torque_forms(p, frames, columns)
        place = np.where(pushing, p, np.nan)
        G, _ = grasp_map(place, n, self.center, forms)
        values, vectors = np.linalg.eigh(_given_way(G, local, self.friction))
        root = np.sqrt(1.0 + np.maximum(values, 0.0) / RIDGE)
        stiff = (vectors / root[:, None]) @ vectors.mT
        soft = (vectors * root[:, None]) @ vectors.mT
        return matvec(soft, forces.unbalanced), stiff @ J

    def torque_forms(
        self, p: Float[np.ndarray, "M C 3"], frames: Frames, columns: np.ndarray | None = None
    ) -> Float[np.ndarray, "M E C 3"] | None:
        """What of the torques no actuator can make, as forms of forces at points of links; None: they make all.

        Args:
            p: Points (M, C, 3), world frame.
            frames: Where the links are.
            columns: The links (C,); None: all.
        """
        if not len(self.forms):
            return None
        links = np.arange(p.shape[1]) if columns is None else columns
        axes = frames.axes[..., 6:]
        # Velocity of each point per joint.
        velocity = axes[:, None, :3] - hat(p) @ axes[:, None, 3:]
        velocity = velocity * self.chain.followed(links)[:, None, 6:]
        return np.einsum("ej,mcij->meci", self.forms, velocity)

    def _torque_rows(
        self, frames: Frames, columns: np.ndarray, p: np.ndarray, f: np.ndarray, point: np.ndarray, force: np.ndarray
    ) -> np.ndarray:
        """Derivative (M, E, 6 + n) of the combinations of torques, S . W summed over the forces' wrenches W."""
        chain, links = self.chain, len(self.chain.links)
        m, C = len(chain.joints), len(columns)
        S = frames.axes[..., 6:].mT
        joint_follows = chain.followed(columns)[:, 6:]
        W = np.concatenate([f, np.cross(p, f)], axis=-1)
        total = np.einsum("cj,mcw->mjw", joint_follows, W)
        force_of, moment_of, slide_of, turn = total[..., :3], total[..., 3:], S[..., :3], S[..., 3:]
        moved = np.concatenate([np.cross(turn, force_of), np.cross(slide_of, force_of) + np.cross(turn, moment_of)], -1)
        by_axes = chain.pull(frames, moved, links + np.arange(m))
        changed = np.concatenate([force, hat(p) @ force - hat(f) @ point], axis=-2)
        pulled = chain.pull(frames, changed.reshape(len(p), C * 6, 6), np.repeat(columns, 6))
        pulled = pulled.reshape(len(p), C, 6, -1)
        by_wrench = np.einsum("mjw,cj,mcwx->mjx", S, joint_follows, pulled)
        return self.forms @ (by_axes + by_wrench)


def _carried(
    witness: Witness, E: np.ndarray, K_link: np.ndarray, K_object: np.ndarray, n: np.ndarray, f: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Derivatives (M, C, 3, 6) of contact points and of forces f (M, C, 3), in the twist of the link.

    A force keeps its local parts: it turns with the normal as `se3.tangents` do.
    """
    U_link, U_object = slide(witness.point_b, witness.normal, witness.distance, E, K_link, K_object)
    eye = np.eye(3) + np.zeros_like(n[..., None])
    turned = np.concatenate([np.zeros_like(eye), cross(n[..., None, :] + np.zeros_like(eye), eye)], axis=-1)
    normal = turned - E @ (K_link @ U_link)
    side = np.where(n[..., 2:] < 0, -1.0, 1.0) + n[..., 2:]
    spin = (n[..., 1:2] * normal[..., 0, :] - n[..., 0:1] * normal[..., 1, :]) / side
    # Omega = n x dn + spin n, df = Omega x f.
    omega = hat(n) @ normal + n[..., :, None] * spin[..., None, :]
    return -(E @ U_object), -hat(f) @ omega


def _given_way(G: np.ndarray, local: np.ndarray, friction: float) -> np.ndarray:
    """G N G^T (M, R, R): what unit changes of the forces balance within the active constraints, N projects on these."""
    M, C = local.shape[:2]
    N = _free(local, friction)
    free = G @ N
    product = np.einsum("mcij,mckj->mik", free, free)
    # The pressures sum to 1.
    along = N[..., 0]
    length = np.einsum("mcj,mcj->m", along, along)
    lost = np.einsum("mcij,mcj->mi", free, along)
    scale = np.where(length > 1e-9, 1.0 / np.where(length > 1e-9, length, 1.0), 0.0)
    return product - scale[:, None, None] * lost[:, :, None] * lost[:, None, :]


def _free(local: np.ndarray, friction: float) -> np.ndarray:
    """Projectors (M, C, 3, 3) on the changes of each force that keep its active constraints."""
    angle = (np.arange(EDGES) + 0.5) * 2.0 * np.pi / EDGES
    rim = friction * np.cos(np.pi / EDGES)
    face = np.stack([np.full(EDGES, -rim), np.cos(angle), np.sin(angle)], axis=1)
    pressure = local[..., 0]
    count = (pressure > ACTIVE).sum(axis=1, keepdims=True)
    held = local @ face.T > -ACTIVE
    rows = np.where(held[..., None], face, 0.0)
    capped = pressure > np.maximum(MOST, 1.0 / np.maximum(count, 1)) - ACTIVE
    rows = np.concatenate([rows, np.where(capped[..., None], [1.0, 0.0, 0.0], 0.0)[..., None, :]], axis=-2)
    values, vectors = np.linalg.eigh(rows.mT @ rows)
    kept = (values < 1e-6) & (pressure > ACTIVE)[..., None]
    return (vectors * kept[..., None, :]) @ vectors.mT


def _impossible(hand: Hand, chain: Chain) -> Float[np.ndarray, "E m"]:
    """Unit combinations of the independent joints' torques that no actuator can make, of those of the chain's joints."""
    rows = [np.zeros((0, len(hand.joint_names)))]
    for group in hand.coupled:
        # An orthonormal basis of what is perpendicular to the ratio.
        _, _, basis = np.linalg.svd(np.array(group.ratio, dtype=np.float64)[None])
        row = np.zeros((len(group.joints) - 1, len(hand.joint_names)))
        row[:, [hand.joint_names.index(name) for name in group.joints]] = basis[1:]
        rows.append(row)
    matrix, _, names = hand.mimic_map()
    return np.concatenate(rows) @ matrix[[names.index(name) for name in chain.joints]].T
