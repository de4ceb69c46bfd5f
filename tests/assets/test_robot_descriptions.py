"""Hands of the package robot_descriptions, of which a fake one with its layout is installed here."""

import sys
from pathlib import Path

import pytest

from grasp_refine.assets.robot_descriptions import described
from grasp_refine.core.errors import AssetError
from grasp_refine.hands.hand import load_hand
from made_hands import BALL, joint, links, robot, slide
from refusals import refused

CACHE = """import os
def clone_to_cache(name, commit=None):
    print("Cloning", name)
    path = os.path.join(os.environ["ROBOT_DESCRIPTIONS_CACHE"], name)
    if not os.path.isdir(path):
        raise RuntimeError("fatal: unable to access 'https://example.org/': Could not resolve host")
    return path
"""

MODULE = """from os import path as _path
from ._cache import clone_to_cache as _clone_to_cache
REPOSITORY_PATH: str = _clone_to_cache("{repository}", commit=None)
PACKAGE_PATH: str = _path.join(REPOSITORY_PATH, "claw")
{paths}
"""

FINGER = '<body name="{0}" pos="{1} 0 0"><joint name="{0}" axis="0 1 0" range="-1 1"/><geom size="0.01"/></body>'
CLAW = '<mujoco><worldbody><body name="palm"><geom size="0.02"/>{}{}</body></worldbody></mujoco>'
OPENS = {"limits": (0, 1), "effort": None, "velocity": None}
URDF = robot(
    "arm",
    links("base", "palm") + links("a", "b", inside=BALL),
    slide("lift", "base", "palm", **OPENS),
    joint("a", "palm", "a", **OPENS) + joint("b", "palm", "b", **OPENS),
)


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder of an installed package; its cache holds one repository, another one cannot be cloned."""
    site, cache = tmp_path / "site", tmp_path / "cache"
    package, claw = site / "robot_descriptions", cache / "menagerie" / "claw"
    for folder in (package, site / "robot_descriptions-3.3.0.dist-info", claw):
        folder.mkdir(parents=True)
    (site / "robot_descriptions-3.3.0.dist-info" / "METADATA").write_text(
        "Metadata-Version: 2.1\nName: robot_descriptions\nVersion: 3.3.0\n"
    )
    (package / "__init__.py").write_text("")
    (package / "_cache.py").write_text(CACHE)
    sides = (
        'MJCF_PATH: str = _path.join(PACKAGE_PATH, "right.xml")\nMJCF_PATH_LEFT = _path.join(PACKAGE_PATH, "left.xml")'
    )
    urdf = 'URDF_PATH = _path.join(PACKAGE_PATH, "arm.urdf")'
    for name, repository, paths in (
        ("claw_mj_description", "menagerie", sides),
        ("arm_description", "menagerie", urdf),
        ("far_description", "elsewhere", urdf),
        ("macro_description", "menagerie", 'XACRO_PATH = "a.xacro"'),
    ):
        (package / f"{name}.py").write_text(MODULE.format(repository=repository, paths=paths))
    for side, sign in (("right", ""), ("left", "-")):
        (claw / f"{side}.xml").write_text(CLAW.format(FINGER.format("a", f"{sign}0.03"), FINGER.format("b", "0.05")))
    (claw / "arm.urdf").write_text(URDF)
    monkeypatch.setenv("ROBOT_DESCRIPTIONS_CACHE", str(cache))
    monkeypatch.syspath_prepend(site)
    monkeypatch.chdir(tmp_path)
    for name in [name for name in sys.modules if name.partition(".")[0] == "robot_descriptions"]:
        monkeypatch.delitem(sys.modules, name)
    yield package
    for name in [name for name in sys.modules if name.partition(".")[0] == "robot_descriptions"]:
        del sys.modules[name]


def test_a_hand_and_its_left_one_are_found_by_name(package: Path, capsys: pytest.CaptureFixture[str]) -> None:
    hand = load_hand("robot_descriptions/claw", candidates=16)
    assert (hand.name, hand.urdf.name) == ("robot_descriptions/claw_mj_description", "right.xml")
    left = load_hand("robot_descriptions/claw_mj_description/left", candidates=16)
    assert (left.name, left.urdf.name) == ("robot_descriptions/claw_mj_description/left", "left.xml")
    assert left.joints_by_name["a"].T_parent_child[0, 3] == -hand.joints_by_name["a"].T_parent_child[0, 3]
    assert capsys.readouterr().out == ""


@pytest.mark.parametrize(
    ("name", "named"),
    [
        ("claw/middle", ("middle", "left")),
        ("far", ("far", "resolve host", "ROBOT_DESCRIPTIONS_CACHE")),
        ("macro", ("xacro",)),
        ("nothing", ("nothing", "3.3.0")),
        ("_cache", ("_cache",)),
        ("../claw", ("..",)),
        ("os.path", ("os.path",)),
    ],
)
def test_what_cannot_be_had_says_what_to_do(package: Path, name: str, named: tuple[str, ...]) -> None:
    with refused(AssetError, f"robot_descriptions/{name}", *named):
        described(f"robot_descriptions/{name}", lambda line: None)


def test_a_folder_of_that_name_is_not_run(package: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Python would import it from the current folder."""
    trap = tmp_path / "trap" / "robot_descriptions"
    trap.mkdir(parents=True)
    for name in ("__init__", "claw_mj_description"):
        (trap / f"{name}.py").write_text("raise SystemExit('this was run')")
    monkeypatch.syspath_prepend(trap.parent)
    with refused(AssetError, "claw"):
        described("robot_descriptions/claw", lambda line: None)
