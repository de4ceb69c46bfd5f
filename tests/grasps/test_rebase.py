"""Grasps told from another link of the hand: links stay where they were."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

import made_hands
from grasp_refine.core.errors import GraspFileError
from grasp_refine.core.se3 import exp_se3, pose_from_transform, transform_from_pose
from grasp_refine.grasps.grasp_set import GraspSet, Stage, match_joints
from grasp_refine.grasps.rebase import rebased
from grasp_refine.hands.hand import Hand, load_hand
from grasp_refine.hands.kinematics import Kinematics
from made_hands import links, solid, write_urdf
from refusals import refused


def joint(name: str, parent: str, child: str, axis: str, *follow: object) -> str:
    place = {"at": "0.01 0.02 0.1", "rpy": "0.1 0.2 0.3", "axis": axis, "limits": (-0.4, 1.4)}
    return made_hands.joint(name, parent, child, follow=follow or None, **place)


@pytest.fixture(scope="module")
def urdf(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An arm of two joints, the second of which follows nothing, with a hand of two fingers and a camera."""
    return write_urdf(
        tmp_path_factory.mktemp("arm"),
        links("stand", "upper", "palm", "left", "right", "camera", inside=solid("box 0.02 0.02 0.05")),
        joint("shoulder", "stand", "upper", "0 0 1"),
        joint("wrist", "upper", "palm", "0 1 0"),
        joint("open", "palm", "left", "1 0 0"),
        joint("follow", "palm", "right", "1 0 0", "open", -0.2, 0.1),
        joint("look", "stand", "camera", "0 0 1"),
        name="arm",
    )


def places(grasps: GraspSet, stage: Stage, hand: Hand, name: str) -> np.ndarray:
    q, _ = match_joints(grasps.at(stage), hand)
    T = Kinematics(hand, (name,))(torch.as_tensor(transform_from_pose(stage.pose)), torch.as_tensor(q))
    return T[:, 0].numpy()


@pytest.mark.parametrize(("old", "new"), [("palm", "stand"), ("stand", "palm"), ("stand", "upper"), ("palm", "palm")])
def test_links_stay_where_they_were(urdf: Path, old: str, new: str) -> None:
    def load(base_link: str) -> Hand:
        return load_hand(urdf, base_link=base_link)

    rng = np.random.default_rng(0)
    before = load(old)
    poses = [pose_from_transform(exp_se3(rng.normal(size=(3, 6)))) for _ in range(2)]
    joints = [rng.uniform(0.1, 1.0, (3, len(before.joint_names))) for _ in range(2)]
    grasps = GraspSet("arm", old, before.joint_names, np.full(3, "box:1,1,1"), np.ones(3), poses[0], joints[0])
    grasps = replace(grasps, pregrasp=Stage(poses[1], joints[1]))
    told, after = rebased(grasps, new, load), load(new)
    assert told.base_link == new and told.joint_names == after.joint_names
    assert told.squeeze is None and told.pregrasp is not None and grasps.pregrasp is not None
    for name in ("palm", "left", "right"):
        for one, other in (
            (Stage(grasps.hand_pose, grasps.q), Stage(told.hand_pose, told.q)),
            (grasps.pregrasp, told.pregrasp),
        ):
            expected = places(grasps, one, before, name)
            np.testing.assert_allclose(places(told, other, after, name), expected, atol=1e-12)
    if (old, new) == ("palm", "stand"):
        resting = [after.joint_names.index(name) for name in ("shoulder", "wrist")]
        np.testing.assert_allclose(told.q[:, resting], 0.5)  # the middle of the range


def test_a_link_beside_the_hand_cannot_be_its_base(urdf: Path) -> None:
    hand = load_hand(urdf, base_link="palm")
    grasps = GraspSet(
        "arm",
        "palm",
        ("open",),
        np.full(1, "mug"),
        np.ones(1),
        np.eye(7)[[3]],
        np.full((1, len(hand.joint_names)), 0.2),
    )
    with refused(GraspFileError, "'palm'", "'camera'"):
        rebased(grasps, "camera", lambda base: load_hand(urdf, base_link=base))
