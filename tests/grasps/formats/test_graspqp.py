"""GraspQP: named joints and the pose of its root link, its hands in the frames of the makers'."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from grasp_refine.core.errors import GraspFileError
from grasp_refine.core.se3 import transform_from_pose, transform_points
from grasp_refine.grasps.formats.graspqp import MODELS
from grasp_refine.grasps.formats.grippers import without_follower
from grasp_refine.grasps.formats.listing import FORMATS
from grasp_refine.grasps.formats.reading import reading
from grasp_refine.grasps.grasp_set import match_joints
from grasp_refine.hands.chain import Chain
from grasp_refine.hands.hand import Hand
from refusals import assert_names, refused

Load = Callable[..., Hand]


def contents(hand: str, count: int = 3, **changes: Any) -> dict[str, Any]:
    """What `scripts/fit.py` writes, with joints 0.1, 0.2, ..."""
    parameters = {name: torch.full((count,), 0.1 * (i + 1)) for i, name in enumerate(MODELS[hand].joints)}
    pose = torch.tensor([[0.1, 0.2, 0.3, 0.5, 0.5, -0.5, 0.5]]).repeat(count, 1)
    zeros = {name: torch.zeros(count) for name in parameters}
    return {
        "values": torch.linspace(1.0, 2.0, count),
        "parameters": parameters | {"root_pose": pose} | changes,
        "grasp_velocities": zeros,
        "full_grasp_velocities": zeros,
        "grasp_velocities_off": zeros,
        "contact_idx": torch.zeros(count, 12, dtype=torch.long),
        "grasp_type": "all",
        "contact_links": None,
    }


def save(path: Path, content: Any) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    torch.save(content, path)
    return path


@pytest.mark.parametrize("hand", list(MODELS))
def test_what_its_optimiser_writes(hand: str, tmp_path: Path):
    place = tmp_path / "core-mug" / "grasp_predictions" / hand / "12_contacts" / "graspqp" / "default"
    read = reading(save(place / "core-mug_2.dexgrasp.pt", contents(hand)))
    grasps, model = read.grasps, MODELS[hand]
    assert read.format.name == "graspqp" and set(grasps.object) == {"core-mug"} and set(grasps.scale) == {1.0}
    assert (grasps.hand, grasps.base_link) == (model.layout.hand, model.layout.base_link)
    assert grasps.joint_names == model.layout.joints
    signs = [-1 if name in model.reversed_joints else 1 for name in model.joints]
    np.testing.assert_allclose(grasps.q, [0.1 * np.arange(1, len(signs) + 1) * signs] * 3, atol=1e-6)
    T_root = transform_from_pose(np.array([[0.1, 0.2, 0.3, 0.5, 0.5, -0.5, 0.5]]))
    np.testing.assert_allclose(
        transform_from_pose(grasps.hand_pose), np.repeat(T_root @ model.layout.T_root_base, 3, 0), atol=1e-6
    )
    assert_names(" ".join(read.notes), "energy", "1 to 2", "grasp_velocities")
    np.testing.assert_array_equal(grasps.labels["energy"], [1.0, 1.5, 2.0])
    # The order in the file does not matter.
    held = contents(hand)
    held["parameters"] = dict(reversed(held["parameters"].items()))
    again = reading(save(place / "core-mug_2.dexgrasp.pt", held)).grasps
    np.testing.assert_array_equal(again.q, grasps.q)


# From its URDFs (leggedrobotics/graspqp 744ffbc, graspqp/assets) by yourdfpy, joints in the order of MODELS at 0.3,
# 0.4, 0.5, 0.3, ... rad: points of our links in the root's frame, metres.
WHERE = {
    "allegro": ("base_link", (0.0, 0.0, 0.0267), {
        "link_3.0": (0.0761, 0.1224, 0.0413), "link_7.0": (0.0318, 0.1275, 0.0408),
        "link_11.0": (-0.0203, 0.1345, 0.0263), "link_15.0": (0.1285, -0.016, 0.0068),
    }),
    "shadow_hand": ("forearm", (0.0, 0.0, 0.02), {
        "ffdistal": (0.1102, 0.0253, 0.0763), "mfdistal": (0.0759, 0.0369, 0.0854),
        "rfdistal": (0.0587, 0.0352, 0.0851), "lfdistal": (0.0488, 0.0072, 0.0925),
        "thdistal": (0.1007, -0.0625, 0.0555),
    }),
    "panda": ("panda_hand", (0.0, 0.0, 0.0), {
        "panda_leftfinger": (0.0, 0.03, -0.0166), "panda_rightfinger": (0.0, -0.03, -0.0166),
    }),
}  # fmt: skip


@pytest.mark.parametrize("hand", WHERE)
def test_fingertips_of_our_hands_lie_where_its_own_do_when_joints_bend(hand: str, load: Load, tmp_path: Path):
    base, point, where = WHERE[hand]
    names = MODELS[hand].joints
    bent = {name: torch.full((1,), 0.03 if hand == "panda" else (0.3, 0.4, 0.5)[i % 3]) for i, name in enumerate(names)}
    held = contents(hand, 1, **bent, root_pose=torch.tensor([[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]]))
    grasps = reading(save(tmp_path / "cup.pt", held)).grasps
    ours = load(grasps.hand, base)
    T = Chain(ours, tuple(where))(transform_from_pose(grasps.hand_pose), match_joints(grasps, ours)[0]).T_world_link[0]
    # The two models of the Allegro hand differ by 2.4 mm at the thumb, those of the Shadow hand by 1.7 mm.
    np.testing.assert_allclose(transform_points(T, np.array(point)), list(where.values()), atol=2.5e-3)


@pytest.mark.parametrize(
    ("hand", "palm"),
    [
        ("robotiq2", [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, -0.125]]),
        ("robotiq3", [[0, 0, -1, 0], [-1, 0, 0, 0], [0, 1, 0, -0.08]]),
    ],
)
def test_palms_of_the_robotiq_grippers_lie_below_the_root(hand: str, palm: list[list[float]]):
    """As in its URDFs, whose roll and yaw are 1.57."""
    np.testing.assert_allclose(MODELS[hand].layout.T_root_base[:3], palm, atol=2e-3)


def test_the_second_finger_of_the_franka_hand_follows(tmp_path: Path):
    read = reading(save(tmp_path / "cup.dexgrasp.pt", contents("panda"))).grasps
    both = replace(read, joint_names=("panda_finger_joint2", "panda_finger_joint1"), q=np.repeat(read.q, 2, 1))
    known = FORMATS["graspqp"]

    def load(base_link: str) -> Hand:
        raise AssertionError("nothing is rebased")

    parts, _ = known.write(both, load)
    np.testing.assert_array_equal(parts[0].content["parameters"]["panda_finger_joint1"], read.q[:, 0])
    np.testing.assert_allclose(parts[0].content["parameters"]["root_pose"][0], [0.1, 0.2, 0.3, 0.5, 0.5, -0.5, 0.5])
    apart = replace(both, q=both.q + [[0.0, 0.01]])
    assert without_follower(apart) is apart
    with refused(GraspFileError, "graspqp", "panda_finger_joint2"):
        known.write(apart, load)


def test_hands_that_are_not_known_keep_their_joints(load: Load, tmp_path: Path):
    held = contents("panda")
    held["parameters"] = {"root_pose": held["parameters"]["root_pose"], "a": torch.zeros(3), "b": torch.ones(3)}
    place = save(tmp_path / "cup" / "grasp_predictions" / "mine" / "cup.dexgrasp.pt", held)
    read = reading(place)
    assert (read.grasps.hand, read.grasps.base_link, read.grasps.joint_names) == ("mine", "root", ("a", "b"))
    assert "`hand`" in " ".join(read.notes)
    given = reading(place, hand=load("allegro", "base_link"))
    assert (given.grasps.hand, given.grasps.base_link) == ("allegro", "base_link")
    assert "root link" in " ".join(given.notes)


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"root_pose": torch.zeros(3, 6)}, ("root_pose", "(N, 7)", "(3, 6)")),
        ({"root_pose": torch.ones(3, 7)}, ("root_pose", "row 0")),
        ({"panda_finger_joint1": torch.zeros(2)}, ("panda_finger_joint1", "(3)", "(2,)")),
        ({"panda_finger_joint1": "x"}, ("panda_finger_joint1", "'x'")),
    ],
)
def test_defects_are_named(changes: dict[str, Any], named: tuple[str, ...], tmp_path: Path):
    path = save(tmp_path / "a.pt", contents("panda", **changes))
    with refused(GraspFileError, path, *named):
        reading(path)
    save(path, {"parameters": {"a": torch.zeros(2)}})
    with refused(GraspFileError, path, "graspqp", "root_pose"):
        reading(path)
