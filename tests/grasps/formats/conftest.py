"""Hands and grasps for tests of formats."""

from collections.abc import Callable

import numpy as np
import pytest

from grasp_refine.core.se3 import exp_se3, pose_from_transform
from grasp_refine.grasps.grasp_set import GraspSet, Stage
from grasp_refine.hands.hand import Hand, load_hand

BASES = {"shadow": "palm", "allegro": "base_link", "leap": "palm_lower"}
"""Our hands, and the links that formats begin at."""


@pytest.fixture(scope="session")
def load() -> Callable[[str, str | None], Hand]:
    """Gives one of our hands below a link, each loaded once."""
    there: dict[tuple[str, str | None], Hand] = {}

    def load(name: str, base_link: str | None = None) -> Hand:
        if (name, base_link) not in there:
            there[name, base_link] = load_hand(name, base_link=base_link, candidates=16)
        return there[name, base_link]

    return load


@pytest.fixture
def grasps(load: Callable[[str, str | None], Hand]) -> Callable[..., GraspSet]:
    """Gives grasps of a hand at random poses with random joint values, in all three stages."""

    def grasps(name: str, count: int = 7, base_link: str | None = None) -> GraspSet:
        base = base_link or BASES[name]
        hand = load(name, base)
        random = np.random.default_rng(5)

        def stage() -> Stage:
            pose = pose_from_transform(exp_se3(random.normal(size=(count, 6)) * [0.1, 0.1, 0.1, 2, 2, 2]))
            return Stage(pose, random.uniform(hand.lower, hand.upper, (count, len(hand.joint_names))))

        grasp = stage()
        return GraspSet(
            hand=name,
            base_link=base,
            joint_names=hand.joint_names,
            object=np.array([("mug", "bottle")[i % 2] for i in range(count)]),
            scale=np.array([(0.06, 0.1, 0.0637)[i % 3] for i in range(count)]),
            hand_pose=grasp.pose,
            q=grasp.q,
            pregrasp=stage(),
            squeeze=stage(),
        )

    return grasps
