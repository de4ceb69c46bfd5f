"""Pregrasps: where a hand waits, open, before it closes to a grasp."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float

from grasp_refine.collision.culling import bounding_ball
from grasp_refine.collision.query import Pairs
from grasp_refine.config import Config
from grasp_refine.geometry.body import Body
from grasp_refine.goal import Goal
from grasp_refine.grasp_problem import GraspProblem
from grasp_refine.hand import Hand
from grasp_refine.hand_object import HandObject
from grasp_refine.scene import Scene, links_of
from grasp_refine.solvers.least_squares import Point, Progress, minimise
from grasp_refine.solvers.levenberg_marquardt import LevenbergMarquardt
from grasp_refine.solvers.status import Status

CLEARANCE, CLEARANCE_OTHERS = 0.008, 0.003
"""How far contact links, and all other links, are from the object at least, in metres."""

SOLVER = LevenbergMarquardt(iterations=60, restarts=0)
"""Opening is easy; a grasp that cannot open further need not try for long."""

TOLERANCE = 1e-6
"""Loss (m^2) at which a hand is open: a single link may lack a tenth of a millimetre, at the weight of penetrations."""


def opened(
    scene: Scene, prepared: HandObject | None = None, progress: Progress | None = None
) -> tuple[Float[np.ndarray, "N 4 4"], Float[np.ndarray, "N n"]]:
    """Poses (N, 4, 4) of the base link and joint values (N, n) near the grasps at which the hands are open.

    Every link is at least `CLEARANCE`, or `CLEARANCE_OTHERS`, away from the object and above the table, if there is
    one, and does not penetrate other links; joints are within their limits. The way there is short, by the root as
    well as by the joints. Where there is none, as for a finger behind a rim, the best try comes back; of a grasp that
    is not finite, NaN.

    Args:
        scene: Hand, object and grasps; targets mean nothing here.
        prepared: Of this hand and object, for their pairs of links; None: built here. What is `Gloved` already saves
            half of the time.
        progress: As for `minimise`; what it raises ends the search.
    """
    gloved = prepared if isinstance(prepared, Gloved) else Gloved.over(prepared or HandObject.of(scene))
    goal = Goal.nothing(len(scene.q), len(scene.links))
    scene = replace(scene, target_link=None, target_object=None, direction=None)
    config = Config(solver=SOLVER)
    problem = GraspProblem(scene, goal, config, gloved)
    start = Point(scene.T_world_root, np.clip(scene.q, scene.hand.lower, scene.hand.upper))
    finite = np.isfinite(scene.T_world_root).all(axis=(1, 2)) & np.isfinite(scene.q).all(axis=1)
    status = np.where(finite, Status.RUNNING, Status.NOT_FINITE)
    found = minimise(problem, start, SOLVER, TOLERANCE, status=status, width=config.width, progress=progress).point
    T, q = np.where(finite[:, None, None], found.T, np.nan), np.where(finite[:, None], found.q, np.nan)
    return T, q


@dataclass(frozen=True, eq=False)
class Gloved(HandObject):
    """A hand in thick gloves: where these do not penetrate the object, the links keep their clearances.

    A piece is a core and a ball around it, so that a thicker glove is a larger ball, and distances stay exact. Links
    meet each other without gloves.
    """

    bare: HandObject
    """The same without gloves."""

    @staticmethod
    def over(bare: HandObject) -> Gloved:
        """Such gloves on a hand."""
        return Gloved(bare.hand, bare.object, bare)

    @cached_property
    def pairs(self) -> Pairs:
        """Each gloved link and the object."""
        return Pairs.against(self._gloved, self.object.body)

    @cached_property
    def balls(self) -> np.ndarray:
        """Centre and radius (L, 4) of a ball around each gloved link."""
        return np.array([bounding_ball(body) for body in self._gloved])

    @cached_property
    def own_pairs(self) -> Pairs | None:
        """Pairs of bare links."""
        return self.bare.own_pairs

    @cached_property
    def _gloved(self) -> tuple[Body, ...]:
        links = links_of(self.hand)
        return tuple(_thicker(body, by) for body, by in zip(self.bodies, clearances(self.hand, links), strict=True))


def clearances(hand: Hand, links: tuple[str, ...]) -> Float[np.ndarray, " L"]:
    """How far each link (L,) is from the object at least when the hand is open, in metres."""
    return np.where(np.isin(links, [contact.link for contact in hand.contacts]), CLEARANCE, CLEARANCE_OTHERS)


def _thicker(body: Body, by: float) -> Body:
    return replace(body, pieces=tuple(replace(piece, radius=piece.radius + by) for piece in body.pieces))
