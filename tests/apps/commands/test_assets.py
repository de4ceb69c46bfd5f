"""`refine-grasp assets list`, `fetch` and `verify` as a user meets them."""

from __future__ import annotations

import json
from collections import Counter
from pathlib import Path

import pytest

from asset_server import serving
from command_line import refused
from grasp_refine.assets.cache import asset_folder
from grasp_refine.assets.manifest import read_manifest
from grasp_refine.assets.names import all_assets, choose_asset, find_asset
from grasp_refine.geometry.cache import default_cache
from grasp_refine_apps.cli import main
from refusals import assert_names

pytestmark = pytest.mark.usefixtures("workplace")


@pytest.fixture
def mirror(shared_assets: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The shared folder as the mirror."""
    monkeypatch.setenv("GRASP_REFINE_ASSETS", str(shared_assets))
    monkeypatch.setenv("COLUMNS", "100")
    return shared_assets


@pytest.fixture(autouse=True)
def no_mirror(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("GRASP_REFINE_ASSETS", raising=False)
    monkeypatch.setenv("NO_PROXY", "127.0.0.1")


# Names


@pytest.mark.parametrize(
    ("name", "means"),
    [
        ("ycb_011_banana", "objects/ycb_011_banana"),
        ("objects/ycb/011_banana", "objects/ycb_011_banana"),
        ("banana", "objects/ycb_011_banana"),
        ("dgn/ddg-gd_banana_poisson_002", "objects/dgn_ddg-gd_banana_poisson_002"),
        ("leap", "hands/leap"),
        ("hands/leap", "hands/leap"),
        ("grasps/bodex_shadow", "grasps/bodex_shadow"),
    ],
)
def test_names_mean_what_they_seem_to(name: str, means: str):
    asset = choose_asset(name)
    assert asset.full_name == means
    assert find_asset(name, asset.kind) is asset
    other = {"hands": "objects", "objects": "grasps", "grasps": "hands"}[asset.kind]
    if "/" in name:
        assert find_asset(name, other) is None


# list


def test_list_shows_everything_and_what_is_here(mirror: Path, capsys: pytest.CaptureFixture[str]):
    assert main(["assets", "list", "--json", "list.json"]) == 0
    out = capsys.readouterr().out
    lines = out.splitlines()
    for asset in all_assets():
        (line,) = [line for line in lines if line.split()[:1] == [asset.name]]
        assert line.split()[-2:] == [asset.terms, "-"]
    kinds = Counter(asset.kind for asset in all_assets())
    assert set(kinds) == {"hands", "objects", "grasps"}
    assert all(f"{kind} ({count})" in out for kind, count in kinds.items())
    assert f"{kinds.total()} assets" in out and str(mirror) in out
    document = json.loads(Path("list.json").read_text())
    assert document["schema"] == 1 and document["command"] == "assets list"
    assert len(document["assets"]) == kinds.total() and not any(asset["here"] for asset in document["assets"])
    banana = next(asset for asset in document["assets"] if asset["name"] == "ycb_011_banana")
    assert banana["kind"] == "objects" and banana["scale"] == 1.0 and banana["unit"] == "m"
    assert banana["bytes"] == (mirror / "objects/ycb_011_banana.obj").stat().st_size
    assert "YCB Object and Model Set" in banana["citation"] and banana["terms"] == "open"
    assert main(["assets", "fetch", "banana"]) == 0
    capsys.readouterr()
    assert main(["assets", "list", "banana"]) == 0
    here = {line.split()[0]: line.split()[-1] for line in capsys.readouterr().out.splitlines() if "mesh" in line}
    assert here == {"ycb_011_banana": "yes", "dgn_ddg-gd_banana_poisson_002": "-"}


@pytest.mark.parametrize(("which", "count"), [("hands", 27), ("grasps", 6), ("YCB", 15), ("objects/rdg", 12)])
def test_list_takes_a_kind_or_a_part_of_a_name(which: str, count: int, capsys: pytest.CaptureFixture[str]):
    assert main(["assets", "list", which, "--json", "list.json"]) == 0
    assert len(json.loads(Path("list.json").read_text())["assets"]) == count
    out = capsys.readouterr().out
    assert f"{count} assets" in out and "GRASP_REFINE_ASSETS" in out


# fetch


def test_fetch_shows_licence_and_citation_and_where_files_lie(mirror: Path, capsys: pytest.CaptureFixture[str]):
    assert main(["assets", "fetch", "leap", "ycb/011_banana", "--json", "fetch.json"]) == 0
    out = capsys.readouterr().out
    leap = read_manifest("hands")["leap"]
    path = asset_folder(leap, "mirror") / "leap_right.urdf"
    assert "MIT (A. Agarwal 2023) (open)" in out and leap.citation in out
    assert "https://github.com/dexsuite/dex-urdf" in out and leap.commit in out
    assert str(path) in out and "12 files, 3.07 MB" in out
    facts = json.loads(Path("fetch.json").read_text())["assets"]
    assert [(fact["kind"], fact["name"]) for fact in facts] == [("hands", "leap"), ("objects", "ycb_011_banana")]
    assert facts[0]["path"] == str(path) and facts[0]["files"] == 12 and facts[0]["was_here"] is False
    assert main(["assets", "fetch", "leap", "--json", "again.json"]) == 0
    assert "12 files, 3.07 MB" in capsys.readouterr().out
    (again,) = json.loads(Path("again.json").read_text())["assets"]
    assert again["was_here"] is True


def test_fetch_needs_the_licence_accepted_before_anything_is_fetched(
    mirror: Path, capfd: pytest.CaptureFixture[str], tmp_path: Path
):
    asset = read_manifest("grasps")["dexonomy_shadow"]
    said = refused(capfd, "assets", "fetch", "leap", "dexonomy_shadow", "--json", "fetch.json")
    assert_names(said, "CC BY-NC 4.0", "refine-grasp assets fetch grasps/dexonomy_shadow --accept-license")
    assert not (tmp_path / "cache").exists() and not Path("fetch.json").exists()
    assert main(["assets", "fetch", "dexonomy_shadow", "--accept-license"]) == 0
    assert (asset_folder(asset, "mirror") / "grasp.npy").is_file()
    (asset_folder(asset, "mirror") / "grasp.npy").unlink()
    assert main(["assets", "fetch", "dexonomy_shadow"]) == 0  # it is remembered
    assert "CC BY-NC 4.0 (non-commercial)" in capfd.readouterr().out


def test_fetch_says_in_one_line_that_nobody_answers(monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]):
    with serving(Path()) as server:
        address = server.address
    monkeypatch.setenv("GRASP_REFINE_ASSETS", address)  # nobody listens there any more
    assert main(["assets", "fetch", "leap_cube"]) == 2
    assert_names(capfd.readouterr().err, "127.0.0.1", "Connection refused", "3 times", "GRASP_REFINE_ASSETS=")


# verify


def test_verify_finds_what_is_damaged(mirror: Path, capsys: pytest.CaptureFixture[str]):
    assert main(["assets", "verify"]) == 0
    assert_names(capsys.readouterr().out, default_cache("assets"))
    assert main(["assets", "fetch", "barrett", "banana", "leap_cube"]) == 0
    capsys.readouterr()
    assert main(["assets", "verify", "--json", "verify.json"]) == 0
    assert "whole: 3 (11 files)" in capsys.readouterr().out
    document = json.loads(Path("verify.json").read_text())
    assert [found["state"] for found in document["assets"]] == ["whole"] * 3 and document["not_here"] == []

    barrett = asset_folder(read_manifest("hands")["barrett"], "mirror")
    content = (barrett / "barrett.urdf").read_bytes()
    (barrett / "barrett.urdf").write_bytes(content.replace(b"0", b"1", 1))
    (asset_folder(read_manifest("grasps")["leap_cube"], "mirror") / "cube.urdf").unlink()
    assert main(["assets", "verify", "--json", "verify.json", "--overwrite"]) == 1
    out = capsys.readouterr().out
    (damaged,) = [line for line in out.splitlines() if line.startswith("hands/barrett")]
    assert_names(damaged, "8 files", "1 damaged", "barrett.urdf", barrett)
    assert "refine-grasp assets fetch hands/barrett" in out and "refine-grasp assets fetch grasps/leap_cube" in out
    (missing,) = [line for line in out.splitlines() if line.startswith("grasps/leap_cube")]
    assert_names(missing, "2 files", "1 missing", "cube.urdf")
    assert "whole: 1 (1 file), 1 incomplete, 1 damaged" in out
    found = {fact["name"]: fact for fact in json.loads(Path("verify.json").read_text())["assets"]}
    assert found["barrett"]["damaged"] == ["barrett.urdf"] and found["leap_cube"]["missing"] == ["cube.urdf"]
    assert main(["assets", "verify", "banana"]) == 0

    assert main(["assets", "fetch", "barrett", "leap_cube"]) == 0
    assert (barrett / "barrett.urdf").read_bytes() == content
    assert main(["assets", "verify"]) == 0
