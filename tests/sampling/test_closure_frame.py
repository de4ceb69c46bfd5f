"""Grips: closing joints curl fingers or bring tips together, wrists do not close, the hand comes palm behind."""

from pathlib import Path

import numpy as np
import pytest

import made_hands
from grasp_refine.core.errors import HandError
from grasp_refine.hands.hand import Hand, load_hand
from grasp_refine.sampling.closure_frame import closure_frame
from made_hands import BALL, links, solid, write_urdf
from refusals import refused

TIP = solid("sphere 0.01", "0 0 0.03")
HINGE, SLIDE, SLIDE_BACK = (-0.2, 1.6), (-0.02, 0.05), (-0.05, 0.02)


def joint(name: str, parent: str, child: str, at: str, axis: str, limits: tuple | None = HINGE, *more: float) -> str:
    kind = "prismatic" if limits in (SLIDE, SLIDE_BACK) else "revolute" if limits else "continuous"
    follow = ("l", *more) if more else None
    return made_hands.joint(name, parent, child, kind, at=at, axis=axis, limits=limits, follow=follow)


CLAW = (
    links("base", "palm", "a1", "b1", inside=BALL)
    + links("turn")
    + links("a3", "b3", inside=TIP)
    + joint("wrist", "base", "palm", "0 0 0.1", "1 0 0")
    + joint("spread", "palm", "turn", "0.04 0 0", "0 0 1")
    + joint("a_near", "turn", "a1", "0 0 0.02", "0 -1 0")
    + joint("a_far", "a1", "a3", "0 0 0.04", "0 -1 0")
    + joint("b_near", "palm", "b1", "-0.04 0 0.02", "0 1 0")
    + joint("b_far", "b1", "b3", "0 0 0.04", "0 -1 0", (-1.6, 0.2))
)
"""Two upright fingers at both sides of a palm, at the end of a wrist; they bend towards each other, one of them about
an axis turned round at its far joint, and one is spread as well."""


def write(folder: Path, body: str, base_link: str | None = None) -> Hand:
    return load_hand(write_urdf(folder, body), base_link=base_link, candidates=64)


def jaws(folder: Path, *, mimic: bool = False) -> Hand:
    """A palm and two jaws that slide: each on its own, or the second with the first."""
    return write(
        folder,
        links("palm", "left", "right", inside=BALL)
        + joint("l", "palm", "left", "0.05 0 0.08", "-1 0 0", SLIDE)
        + joint("r", "palm", "right", "-0.05 0 0.08", "-1 0 0", SLIDE_BACK, *([-1] if mimic else [])),
    )


def closing(hand: Hand) -> dict[str, float]:
    return dict(zip(hand.joint_names, closure_frame(hand).closing.tolist(), strict=True))


def test_fingers_curl_towards_each_other_whatever_the_sign_of_their_axes(tmp_path: Path):
    hand = write(tmp_path, CLAW, "base")
    assert closing(hand) == {"wrist": 0, "spread": 0, "a_near": 1, "a_far": 1, "b_near": 1, "b_far": -1}
    closure = closure_frame(hand)
    assert dict(zip(hand.joint_names, closure.spreading, strict=True))["spread"]
    assert closure.spreading.sum() == 1, "the wrist is no finger's"


def test_the_hand_comes_palm_behind_and_closes_across(tmp_path: Path):
    closure = closure_frame(jaws(tmp_path))
    np.testing.assert_allclose(closure.center, [0.0, 0.0, 0.08], atol=1e-6)
    np.testing.assert_allclose(closure.approach, [0.0, 0.0, 1.0], atol=0.1)
    np.testing.assert_allclose(np.abs(closure.across), [1.0, 0.0, 0.0], atol=0.1)
    assert abs(closure.across @ closure.approach) < 1e-12
    assert closure.opening == pytest.approx(0.14, abs=1e-3)


@pytest.mark.parametrize("mimic", [False, True])
def test_jaws_come_together(tmp_path: Path, mimic: bool):
    assert closing(jaws(tmp_path, mimic=mimic)) == ({"l": 1} if mimic else {"l": 1, "r": -1})


def test_a_single_finger_closes_against_the_palm(tmp_path: Path):
    body = links("palm", "jaw", inside=BALL) + joint("l", "palm", "jaw", "0 0 0.08", "0 0 1", SLIDE)
    assert closing(write(tmp_path, body)) == {"l": -1}


def test_joints_without_limits_get_some(tmp_path: Path):
    body = links("palm", "left", "right", inside=BALL) + "".join(
        joint(name, "palm", name, f"{x} 0 0.05", "0 1 0", None) for name, x in (("left", 0.05), ("right", -0.05))
    )
    closure = closure_frame(write(tmp_path, body))
    for value in (closure.lower, closure.upper, closure.opened):
        assert np.isfinite(value).all()


def test_a_hand_that_cannot_move_cannot_grip(tmp_path: Path):
    hand = write(tmp_path, links("palm", inside=BALL))
    with refused(HandError, "'hand'"):
        closure_frame(hand)


BENDS = {
    "allegro/allegro_right.urdf": [f"joint_{i}.0" for i in (1, 2, 3, 5, 6, 7, 9, 10, 11, 14, 15)],
    "leap/leap_right.urdf": ["1", "2", "3", "5", "6", "7", "9", "10", "11", "14", "15"],
    "shadow/shadow_right.urdf": [f"{f}J{i}" for f in ("FF", "MF", "RF", "LF") for i in (1, 2, 3)] + ["THJ1"],
    "robotiq3f/robotiq3f.urdf": [f"finger_{f}_joint_{i}" for f in ("1", "2", "middle") for i in (1, 2, 3)],
}
"""Joints that everybody knows to close these hands as they rise; those of Barrett's close as they fall."""


@pytest.mark.parametrize("named", [True, False])
@pytest.mark.parametrize("urdf", [*BENDS, "barrett/barrett.urdf"])
def test_real_hands_close_as_they_do(shared_assets: Path, urdf: str, named: bool):
    path = shared_assets / "hands" / urdf
    name = path.parent.name
    hand = load_hand(name, urdf=path, candidates=64) if named else load_hand(path, candidates=64)
    signs = closing(hand)
    if name == "barrett":
        bends = [joint for joint in signs if "med" in joint or "dist" in joint]
        assert all(signs[joint] == (-1 if joint in bends else 0) for joint in signs)
    else:
        assert all(signs[joint] == 1 for joint in BENDS[urdf])
    assert not any(signs[joint] for joint in signs if joint.startswith("WR"))
