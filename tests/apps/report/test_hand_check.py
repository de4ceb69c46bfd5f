"""`refine-grasp hands --check`: what was understood and why, what looks wrong, and a hand.toml to start from."""

import json
import re
import tomllib
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

from command_line import refused
from grasp_refine.hands.files.hand_toml import KEYS
from grasp_refine.hands.hand import Hand, load_hand
from grasp_refine_apps.cli import main
from grasp_refine_apps.report.hand_check import check_hand
from grasp_refine_apps.report.hand_toml_text import hand_toml_text
from made_hands import BALL, joint, link, solid, write_urdf
from refusals import assert_names
from spread_gripper import spread_gripper
from underactuated import underactuated

LIMIT = '<limit lower="-1" upper="1" effort="1" velocity="1"/>'


def pincers(folder: Path, *, limit: str = LIMIT, links: str = "", joints: str = "", size: float = 0.01) -> Path:
    """A palm and two fingers of one joint each; further links and joints hang from them."""
    ball = solid(f"sphere {size}")
    fingers = (
        link(name, ball) + joint(f"{name}_j", "palm", name, "revolute", limit, at=(x, 0, 0), axis="0 1 0")
        for name, x in (("left", -0.04), ("right", 0.04))
    )
    return write_urdf(folder, link("palm", ball), *fingers, links, joints, name="pincers")


def hung(inside: str, kind: str = "fixed", *more: str) -> dict[str, str]:
    """A further link of the left finger, as options of `pincers`."""
    return {"links": link("extra", inside), "joints": joint("extra_j", "left", "extra", kind, *more)}


def suspicious(path: Path) -> list[str]:
    return list(check_hand(load_hand(path, candidates=16)).suspicious)


def same(one: Hand, other: Hand) -> None:
    """Nothing, when two hands are alike but for where their description is."""
    for field in fields(Hand):
        if field.name in ("toml", "base_why", "contacts_guessed", "notes", "links", "joints"):
            continue
        a, b = getattr(one, field.name), getattr(other, field.name)
        if field.name == "actuator":
            for column in fields(a):
                np.testing.assert_array_equal(getattr(a, column.name), getattr(b, column.name))
        elif isinstance(a, np.ndarray):
            np.testing.assert_array_equal(a, b)
        elif isinstance(a, Path):
            assert a.resolve() == b.resolve()
        else:
            assert a == b, field.name
    assert [link.name for link in one.links] == [link.name for link in other.links]


# the hand.toml that is written


@pytest.mark.parametrize("make", [underactuated, spread_gripper])
def test_the_hand_is_read_again_as_it_was(make, tmp_path: Path) -> None:
    bare = make(tmp_path, arm=True) if make is spread_gripper else make(tmp_path, toml=False)
    bare = load_hand(bare.urdf, candidates=16)
    (tmp_path / "hand.toml").write_text(hand_toml_text(bare, tmp_path))
    again = load_hand(tmp_path, candidates=16)
    same(bare, again)
    assert again.toml == tmp_path / "hand.toml" and "hand.toml" in again.base_why
    # What was guessed, and where the hand begins, is told no more.
    links = ", ".join(contact.link for contact in bare.contacts)
    assert any(links in note for note in bare.notes)
    assert not any(links in note or "`base_link" in note for note in again.notes)
    assert bare.contacts_guessed and not again.contacts_guessed
    # What was read from a hand.toml is written anew, and read.
    (tmp_path / "hand.toml").write_text(hand_toml_text(again, tmp_path))
    same(again, load_hand(tmp_path, candidates=16))


def test_a_hand_of_ours_is_read_again_from_elsewhere(tmp_path: Path) -> None:
    """Everything that a hand.toml can say: points, normals, names in an MJCF, numbers per joint."""
    allegro = load_hand("allegro", candidates=16)
    (tmp_path / "hand.toml").write_text(hand_toml_text(allegro, tmp_path))
    again = load_hand(tmp_path, candidates=16)
    same(allegro, again)
    assert len(again.mjcf_joints) == 16 and again.contacts[0].normal is not None
    said = tomllib.loads((tmp_path / "hand.toml").read_text())
    assert not Path(said["urdf"]).is_absolute() and said["name"] == "allegro"


def test_numbers_of_single_joints_couplings_and_odd_names_survive(tmp_path: Path) -> None:
    path = pincers(tmp_path)
    path.write_text(path.read_text().replace("left_j", "l&quot;\\\u00e9").replace('effort="1"', "", 1))
    (tmp_path / "hand.xml").write_text("<mujoco/>")
    (tmp_path / "hand.toml").write_text(
        """mjcf = "hand.xml"
        collision = "mjcf"
        mjcf_joints = { right_j = "r" }
        rest_pose = { right_j = 0.1 }
        coupled = [{ joints = ['l"\\\u00e9', "right_j"], ratio = [1.0, -0.5] }]
        actuator = { kp = { default = 2.0, right_j = 3.0 }, damping = 0.0 }
        contact = [{ link = "left", group = "thumb", point = [0.01, 0, 0], normal = [1, 0, 0] }]
        """
    )
    hand = load_hand(tmp_path, candidates=16)
    assert np.isinf(hand.actuator.force_limit[0]) and hand.actuator.force_limit[1] == 1
    (tmp_path / "hand.toml").write_text(hand_toml_text(hand, tmp_path))
    same(hand, load_hand(tmp_path, candidates=16))


def test_every_key_is_explained(tmp_path: Path) -> None:
    text = hand_toml_text(load_hand(pincers(tmp_path), candidates=16), tmp_path)
    assert all(key in text for key in KEYS if key != "mjcf_joints")
    assert all(word in text for word in ("point", "normal", "ratio"))
    assert re.search(r'left_j" = 0\.0 +# .*-57\.3 .*\b57\.3', text), "in degrees"
    assert max(map(len, text.splitlines())) <= 120


# where it is written


def test_the_width_of_jaws_is_reported_in_millimetres(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["hands", "--check", "franka_hand"]) == 0
    assert_names(capsys.readouterr().out.replace("\n", " "), "two jaws", "0.0 to 80.0 mm wide", "40.0 mm")
    assert check_hand(load_hand("franka_hand", candidates=512)).jaws == pytest.approx((0.0, 0.08), abs=1e-9)
    assert check_hand(load_hand("allegro", candidates=16)).jaws == ()


def test_it_is_written_beside_the_urdf_once(workplace: Path, capfd: pytest.CaptureFixture[str]) -> None:
    path = pincers(workplace)
    assert suspicious(path) == []
    assert main(["hands", "--check", str(path)]) == 0
    assert "--write" in capfd.readouterr().out and [file.name for file in workplace.iterdir()] == ["pincers.urdf"]
    assert main(["hands", "--check", "--write", str(path), "--json", "check.json"]) == 0
    out = " ".join(capfd.readouterr().out.split())
    assert f"{workplace}/hand.toml" in out
    written = (workplace / "hand.toml").read_bytes()
    assert load_hand(path, candidates=16).name == "pincers"
    (hand,) = json.loads(Path("check.json").read_text())["hands"]
    assert hand["written"] == str(workplace / "hand.toml") and "2" in hand["base_link_why"]
    assert hand["check"]["pairs"]["neighbours"] == 2 and hand["check"]["refused"] == ""
    # The second time it is used, and stays.
    assert main(["hands", "--check", str(path)]) == 0
    out = " ".join(capfd.readouterr().out.split())
    assert out.count("hand.toml") >= 2
    assert_names(refused(capfd, "hands", "--check", path, "--write"), "hand.toml", "--overwrite")
    assert (workplace / "hand.toml").read_bytes() == written
    (workplace / "hand.toml").write_text('name = "tongs"')
    assert main(["hands", "--check", str(path), "--write", "--overwrite"]) == 0
    assert "tongs" in (workplace / "hand.toml").read_text() != 'name = "tongs"'
    assert sorted(file.name for file in workplace.iterdir()) == ["check.json", "hand.toml", "pincers.urdf"]


def test_a_hand_toml_of_another_urdf_is_left_alone(workplace: Path, capfd: pytest.CaptureFixture[str]) -> None:
    path = pincers(workplace)
    (workplace / "other.urdf").write_text(path.read_text())
    (workplace / "hand.toml").write_text('urdf = "other.urdf"')
    assert "--overwrite" in refused(capfd, "hands", path, "--check", "--write")
    assert (workplace / "hand.toml").read_text() == 'urdf = "other.urdf"'
    for folder in ("new", "there"):
        (workplace / "there").mkdir(exist_ok=True)
        assert main(["hands", str(path), "--check", "--write", "--out", folder]) == 0
        same(load_hand(path, candidates=16), load_hand(workplace / folder, candidates=16))


def test_places_that_cannot_be_are_refused(workplace: Path, capfd: pytest.CaptureFixture[str]) -> None:
    path = pincers(workplace)
    (workplace / "there").mkdir()
    (workplace / "there/hand.toml").touch()
    assert_names(
        refused(capfd, "hands", "--check", path, "--write", "--out", "there"), "there/hand.toml", "--overwrite"
    )
    assert_names(refused(capfd, "hands", "--check", path, "--write", "--out", "pincers.urdf"), "pincers.urdf")
    for options in (("--write",), ("--write", "--out", "there2"), ("--check", "--out", "there2")):
        assert_names(refused(capfd, "hands", path, *options), "--write", "--check", "--out")
    message = refused(capfd, "hands", "--check", "--base-link", "palm")
    assert_names(message, "--base-link", "--check", "refine-grasp hands HAND --base-link")


# what is said


def test_an_arm_a_chain_of_mimic_joints_and_their_limits_are_reported(
    workplace: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    hand = underactuated(workplace / "five", toml=False)
    assert main(["hands", "--check", str(hand.urdf)]) == 0
    lines = capsys.readouterr().out.splitlines()
    out = " ".join(" ".join(lines).split())
    assert max(map(len, lines[1:-1])) <= 80, "but for the paths"
    assert re.search(r"\b6 joints\b.*\b6\b.*\b13 links\b.*\b12\b", out)
    assert re.search(r"1 x thumb_1 \+ 5\.7\b.* thumb_2\b", out)
    assert re.search(r"'little_1' .*\b0 to 1 rad\b.*\b0 to 1\.5\b", out)
    assert re.search(r"\bthumb_c\b.* 'thumb'.* 'thumb_yaw'", out)
    assert "joints 12" in out
    arm = spread_gripper(workplace / "arm", arm=True)
    assert main(["hands", "--check", str(arm.urdf)]) == 0
    out = " ".join(capsys.readouterr().out.split())
    assert re.search(r"'palm': .*\b3 ", out)
    assert re.search(r"\blift, wrist\b.* --base-link stand\b", out)
    assert main(["hands", str(arm.urdf), "--base-link", "stand"]) == 0
    assert "wrist continuous free free 0.0" in " ".join(capsys.readouterr().out.split())


@pytest.mark.parametrize(
    ("options", "named"),
    [
        ({"limit": '<limit lower="-1" upper="1"/>'}, ("left_j, right_j", "effort", "force_limit")),
        ({"limit": '<limit lower="0" upper="90" effort="1"/>'}, ("left_j, right_j", "degrees", "radians")),
        ({"limit": LIMIT.replace('effort="1"', 'effort="60000"')}, ("left_j (60000), right_j (60000)",)),
        ({"size": 10.0}, ("20.1 m", "millimetres")),
        (hung(solid("sphere 1", kind="visual")), ("extra", "collision")),
        (hung("", "continuous"), ("extra_j", "0")),
        (hung(BALL, "prismatic", '<limit lower="0" upper="40" effort="1"/>'), ("extra_j", "millimetres", "metres")),
        (hung('<inertial><mass value="99"/></inertial>'), ("99 kg",)),
        (hung(BALL, "fixed", '<mimic joint="right_j"/>'), ("extra_j", "mimic")),
    ],
)
def test_what_looks_wrong_is_reported(tmp_path: Path, options: dict, named: tuple[str, ...]) -> None:
    found = suspicious(pincers(tmp_path, **options))
    assert any(all(one in line for one in named) for line in found), found


def test_masses_that_are_made_up_for_the_simulation_are_reported(tmp_path: Path) -> None:
    path = pincers(tmp_path)
    zero = '<inertial><mass value="0.1"/><inertia ixx="0" ixy="0" ixz="0" iyy="0" iyz="0" izz="0"/></inertial>'
    path.write_text(path.read_text().replace('<link name="left">', f'<link name="left">{zero}'))
    found = check_hand(load_hand(path, candidates=16))
    assert found.refused == "" and re.findall(r"\d+", found.simulation[0]) == ["2", "0", "3", "2"]
    assert any("inertia" in line and "left" in line for line in found.simulation)
    assert any("mass" in line and "palm, right" in line for line in found.simulation)


def test_tiny_idle_and_rigid_hands_are_reported(tmp_path: Path) -> None:
    ball = BALL.replace("0.01", "0.001")
    (tmp_path / "a.urdf").write_text(f'<robot name="r"><link name="a">{ball}</link></robot>')
    found = suspicious(tmp_path / "a.urdf")
    # It has no joint, is tiny, and has nothing to touch with.
    assert len(found) == 3 and sum("2 mm" in line for line in found) == 1
    (tmp_path / "b.urdf").write_text(
        f'<robot name="r"><link name="a">{BALL}</link><link name="b"/><joint name="idle_j" type="revolute">'
        f'<parent link="a"/><child link="b"/>{LIMIT}</joint></robot>'
    )
    assert any("idle_j" in line for line in suspicious(tmp_path / "b.urdf"))


def test_links_that_always_overlap_are_named(tmp_path: Path) -> None:
    # Two fingers whose balls are in each other, however they turn.
    path = pincers(tmp_path, size=0.045)
    found = check_hand(load_hand(path, candidates=16)).pairs
    assert found.nearly_always == (("left", "right"),) and found.checked == () and found.neighbours == 2
    found = check_hand(load_hand(pincers(tmp_path), candidates=16)).pairs
    assert (found.at_rest, found.nearly_always, found.checked, found.never) == ((), (), (), 1)
