"""Digests of hands: every file that a hand or its arm is read from counts, and no other."""

import shutil
from pathlib import Path

import pytest

from grasp_refine.problem.spec import ProblemSpec
from grasp_refine_apps.batch.digests import Digests
from made_hands import joint, link, links, solid, write_urdf

FILES = {
    "hand/hand.toml": 'mjcf = "hand.xml"\n',
    "hand/hand.xml": '<mujoco><compiler meshdir="assets"/><asset><mesh file="palm.obj"/></asset>\n'
    '<include file="finger.xml"/></mujoco>',
    "hand/finger.xml": '<mujocoinclude><include file="tip.xml"/></mujocoinclude>',
    "hand/tip.xml": '<mujocoinclude><asset><mesh file="assets/tip.stl"/></asset></mujocoinclude>',
    "hand/assets/palm.obj": "palm",
    "hand/assets/tip.stl": "tip",
    "hand/finger.stl": "finger",
    "arm/arm.toml": "",
    "arm/rod.stl": "rod",
}
OTHERS = ("hand/notes.txt", "hand/assets/unused.obj", "arm/unused.stl")
TURN = {"axis": "0 0 1", "limits": (-1, 1)}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A hand with an MJCF of several files beside its URDF, and an arm."""
    made = tmp_path / "made"
    for name, text in {**FILES, **dict.fromkeys(OTHERS, "other")}.items():
        (made / name).parent.mkdir(parents=True, exist_ok=True)
        (made / name).write_text(text)
    finger, rod = (solid(f"mesh {name}.stl") for name in ("finger", "rod"))
    write_urdf(made / "hand", links("palm") + link("finger", finger), joint("j", "palm", "finger", **TURN))
    write_urdf(made / "arm", links("stand") + link("rod", rod), joint("j", "stand", "rod", **TURN), name="arm")
    return made


def digest(folder: Path, arm: bool = True) -> str:
    spec = ProblemSpec(hand=str(folder / "hand"), arm=str(folder / "arm/arm.urdf") if arm else None)
    return Digests().hand(spec.hand, spec, lambda line: None)[1]


@pytest.mark.parametrize("changed", [*FILES, "hand/hand.urdf", "arm/arm.urdf", *OTHERS])
def test_a_digest_changes_with_each_file_of_hand_and_arm_alone(folder: Path, tmp_path: Path, changed: str) -> None:
    before, alone = digest(folder), digest(folder, arm=False)
    assert before != alone and digest(Path(shutil.copytree(folder, tmp_path / "copy"))) == before
    file = folder / changed
    file.write_text(file.read_text() + "\n")
    counts = changed not in OTHERS
    assert (digest(folder) != before) == counts
    assert (digest(folder, arm=False) != alone) == (counts and changed.startswith("hand"))
