"""Which files a hand's name means: ours, the user's, or an asset's."""

from pathlib import Path

import pytest

from grasp_refine.assets.embedded import resource_dir
from grasp_refine.core.errors import AssetError, HandError
from grasp_refine.hands.files.hand_toml import HAND_TOML
from grasp_refine.hands.files.source import hand_files, list_hands, needs_urdf
from grasp_refine.hands.hand import load_hand
from refusals import assert_names, refused


@pytest.fixture
def mirror(shared_assets: Path, workplace: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The shared folder as a mirror of the assets, and an empty cache."""
    monkeypatch.setenv("GRASP_REFINE_ASSETS", str(shared_assets))
    return shared_assets


def silent(line: str) -> None:
    raise AssertionError(f"nothing should be fetched: {line}")


def test_our_own_hands_need_nothing_from_elsewhere() -> None:
    for name in list_hands():
        if not needs_urdf(name):
            assert hand_files(name, None, None, silent)[1].file.is_file()
    assert {"barrett", "robotiq3f"} == {name for name in list_hands() if needs_urdf(name)}


@pytest.mark.parametrize("name", ["barrett", "robotiq3f"])
def test_the_urdf_of_a_hand_without_one_is_fetched(name: str, mirror: Path) -> None:
    said: list[str] = []
    found, toml = hand_files(name, None, None, said.append)
    assert found == name and toml.path == resource_dir("robots") / name / HAND_TOML
    assert toml.file.read_bytes() == (mirror / f"hands/{name}/{name}.urdf").read_bytes()
    (line,) = said
    assert_names(line, f"hands/{name}", "BSD")
    hand_files(name, None, None, silent)


def test_an_asset_has_what_our_hand_toml_says_of_it(mirror: Path) -> None:
    said: list[str] = []
    hand = load_hand("hands/leap", candidates=16, progress=said.append)
    assert_names(said[0], "hands/leap", "MIT")
    # Grasps of it are not to be taken for those of ours, which has another shape.
    assert hand.name == "hands/leap" and hand.urdf.name == "leap_right.urdf"
    ours = load_hand("leap", candidates=16)
    assert ours.urdf != hand.urdf
    assert set(hand.joint_names) == set(ours.joint_names) and hand.contacts == ours.contacts


def test_a_path_wins_over_an_asset(mirror: Path, workplace: Path) -> None:
    folder = workplace / "hands" / "leap"
    folder.mkdir(parents=True)
    (folder / "mine.urdf").write_text("<robot/>")
    assert hand_files("hands/leap", None, None, silent)[1].file == Path("hands/leap/mine.urdf")


def test_an_mjcf_may_be_an_asset(mirror: Path) -> None:
    toml = hand_files("shadow", None, Path("shadow_mjcf"), lambda line: None)[1]
    assert toml.mjcf.read_bytes() == (mirror / "hands/shadow_mjcf/right_hand.xml").read_bytes()
    with refused(HandError, "nothing.xml"):
        hand_files("shadow", None, Path("nothing.xml"), silent)


def test_without_a_network_both_ways_out_are_named(workplace: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GRASP_REFINE_ASSETS", "http://127.0.0.1:9")
    with refused(AssetError, "'barrett'", "`urdf=FILE`", "GRASP_REFINE_ASSETS"):
        hand_files("barrett", None, None, lambda line: None)


@pytest.mark.parametrize("name", ["a" * 300, "a/" * 3000 + "b.urdf", "~nobody-is-called-so/x"])
def test_what_cannot_be_a_path_is_no_hand(workplace: Path, name: str) -> None:
    with pytest.raises((AssetError, HandError)) as caught:
        hand_files(name, None, None, silent)
    assert_names(str(caught.value), name[:20])


def test_a_hand_of_ours_in_capitals_is_no_asset() -> None:
    """The asset `hands/allegro` is another model."""
    with refused(AssetError, "'Allegro'", "did you mean allegro?"):
        load_hand("Allegro")
