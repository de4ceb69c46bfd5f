"""Hands without collision geometry, whose links collide as they look."""

from pathlib import Path

import pytest

from grasp_refine.core.errors import HandError
from grasp_refine.hands.hand import Hand, load_hand
from grasp_refine.hands.solid_links import check_collides
from grasp_refine_apps.cli import main
from made_hands import joint, link, solid, write_urdf
from refusals import refused


def pincers(folder: Path, kind: str = "visual", tip: str = "visual") -> Path:
    """A forearm, a palm that turns on it, and two fingers, of geometry of one kind; the left finger of another."""
    finger = "box .012 .02 .06"
    return write_urdf(
        folder,
        link("forearm", solid("box .04 .04 .1", "0 0 -.06", kind=kind)),
        link("palm", solid("box .08 .06 .02", "0 0 0", kind=kind)),
        link("left", solid(finger, "0 0 .03", kind=tip)),
        link("right", solid(finger, "0 0 .03", kind=kind)),
        *(
            joint(f"{name}_j", parent, name, at=(x, 0, ".01"), axis="0 1 0", limits=(-1, 1), effort=5)
            for name, parent, x in (("palm", "forearm", "0"), ("left", "palm", "-.03"), ("right", "palm", ".03"))
        ),
        name="pincers",
    )


def sizes(hand: Hand) -> dict[str, float]:
    return {link.name: link.body.diagonal for link in hand.links if link.body is not None}


def test_links_collide_as_they_look_where_that_is_chosen(tmp_path: Path) -> None:
    bare = load_hand(pincers(tmp_path), candidates=16)
    assert bare.base_link == "palm" and sizes(bare) == {} and bare.contacts == ()
    with refused(HandError, "pincers.urdf", "`collision='visual'`"):
        check_collides(bare)
    seen = load_hand(pincers(tmp_path), candidates=16, collision="visual")
    check_collides(seen)
    assert [contact.link for contact in seen.contacts] == ["left", "right"]
    plain = load_hand(pincers(tmp_path, "collision", "collision"), candidates=16)
    assert sizes(seen) == sizes(plain) and seen.base_link == plain.base_link


def test_links_without_visuals_keep_their_collision_geometry(tmp_path: Path) -> None:
    hand = load_hand(pincers(tmp_path, tip="collision"), candidates=16, collision="visual")
    assert set(sizes(hand)) == {"palm", "left", "right"}


def test_a_hand_toml_can_choose_it_and_is_written_with_it(tmp_path: Path) -> None:
    path = pincers(tmp_path)
    assert main(["hands", "--check", str(path), "--collision", "visual", "--write"]) == 0
    assert set(sizes(load_hand(tmp_path, candidates=16))) == {"palm", "left", "right"}


def test_a_check_of_a_hand_that_cannot_touch_ends_with_1(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = pincers(tmp_path)
    assert main(["hands", "--check", str(path)]) == 1
    assert "--collision visual" in capsys.readouterr().out
    assert main(["hands", "--check", str(path), "--collision", "visual"]) == 0


def test_an_mjcf_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "hand.xml"
    path.write_text("""<mujoco><worldbody><body name="palm"><geom size=".02"/><body name="f" pos="0 0 .1">
      <joint name="j" axis="0 1 0" range="-1 1"/><geom size=".01"/></body></body></worldbody></mujoco>""")
    with refused(HandError, "hand.xml", "MJCF"):
        load_hand(path, collision="visual")
