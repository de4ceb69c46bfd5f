"""Fetching for real, from a web server on this machine and from folders; what arrives wrong leaves nothing behind."""

import hashlib
import json
import re
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from asset_server import CONTENTS, MIDDLE, Server, made_asset, made_tree, serving
from command_line import subprocess_environment
from grasp_refine.assets.cache import asset_folder, is_whole, path_inside
from grasp_refine.assets.download import MAX_ATTEMPTS
from grasp_refine.assets.fetching import fetch_asset
from grasp_refine.assets.licence import is_accepted
from grasp_refine.assets.locating import locate_asset
from grasp_refine.assets.manifest import Asset, read_manifest
from grasp_refine.assets.names import all_assets
from grasp_refine.assets.origin import Mirror, Upstream
from grasp_refine.assets.verifying import verify
from grasp_refine.core.errors import AssetError
from refusals import assert_names, refused
from running_processes import PATIENCE_S


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A cache of its own; no mirror, no proxy."""
    monkeypatch.setenv("GRASP_REFINE_CACHE", str(tmp_path / "cache"))
    monkeypatch.delenv("GRASP_REFINE_ASSETS", raising=False)
    monkeypatch.setenv("NO_PROXY", "127.0.0.1")
    return tmp_path / "cache" / "assets"


@pytest.fixture
def server(tmp_path: Path) -> Iterator[Server]:
    with serving(made_tree(tmp_path / "mirror")) as running:
        yield running


@pytest.fixture
def claw(tmp_path: Path) -> Asset:
    return made_asset(tmp_path / "manifest")


def fetch(asset: Asset, server: Server, **options: object) -> Path:
    return fetch_asset(asset, Mirror(server.address), pause=0.01, **options)


def refusal(asset: Asset, server: Server) -> str:
    """The message of a fetch that fails; an error that is kept would hold its connection until garbage is collected."""
    try:
        fetch(asset, server)
    except AssetError as error:
        return str(error)
    pytest.fail("it was fetched")


def files_in(folder: Path) -> dict[str, bytes]:
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if not path.is_dir()}


def test_files_arrive_whole_and_find_each_other(claw: Asset, server: Server, cache: Path):
    told: list[tuple[str, int, int | None]] = []
    folder = fetch(claw, server, progress=lambda *now: told.append(now))
    assert files_in(folder) == CONTENTS
    assert folder.parent == cache / "hands" / "claw"
    total = sum(map(len, CONTENTS.values()))
    done = [now[1] for now in told]
    assert done == sorted(done) and done[0] == 0 and done[-1] == total
    assert {now[2] for now in told} == {total}
    assert list(dict.fromkeys(now[0] for now in told)) == list(CONTENTS)
    assert all(path.stat().st_mode & 0o044 == 0o044 for path in folder.rglob("*") if path.is_file())


def test_what_is_here_is_not_fetched_again_and_what_was_damaged_is(claw: Asset, server: Server):
    folder = fetch(claw, server)
    server.asked.clear()
    fetch(claw, server)
    assert not server.asked
    (folder / "claw.urdf").write_bytes(b"x" * len(CONTENTS["claw.urdf"]))
    (folder / "meshes/palm.obj").unlink()
    fetch(claw, server)
    assert server.asked == {"/claw/claw.urdf": 1, "/claw/meshes/palm.obj": 1}
    assert files_in(folder) == CONTENTS


def test_a_read_only_folder_is_a_mirror_too(claw: Asset, tmp_path: Path):
    mirror = made_tree(tmp_path / "mirror")
    for path in (*mirror.rglob("*"), mirror):
        path.chmod(0o555 if path.is_dir() else 0o444)
    try:
        assert files_in(fetch_asset(claw, Mirror(mirror))) == CONTENTS
    finally:
        for path in (mirror, *filter(Path.is_dir, mirror.rglob("*"))):
            path.chmod(0o755)


def test_files_come_from_upstream_under_their_own_paths(claw: Asset, tmp_path: Path, cache: Path):
    made_tree(tmp_path / "tree/made/up").joinpath("claw").rename(tmp_path / "tree/made/up" / claw.commit)
    with serving(tmp_path / "tree") as server:
        folder = fetch_asset(claw, Upstream(server.address), pause=0.01)
        assert set(server.asked) == {f"/made/up/{claw.commit}/{name}" for name in CONTENTS}
    assert folder.name.startswith("upstream-") and files_in(folder) == CONTENTS
    assert not is_whole(claw, "mirror"), "a mirror's copy is another one"


@pytest.mark.parametrize(
    ("fault", "attempts", "named"),
    [
        ("wrong", MAX_ATTEMPTS, ("sha256", hashlib.sha256(CONTENTS["meshes/tip.obj"]).hexdigest())),
        ("cut", MAX_ATTEMPTS, ("127.0.0.1:", f"{MAX_ATTEMPTS} times")),
        ("long", 1, ("320000 bytes",)),
        ("short", MAX_ATTEMPTS, ("sha256",)),
        ("endless", 1, ("320000 bytes",)),
        (404, 1, ("404 Not Found", "http://127.0.0.1:", "/claw/meshes/tip.obj")),
        (503, MAX_ATTEMPTS, ("127.0.0.1:", "503", "GRASP_REFINE_ASSETS=")),
        ("to file:///etc/passwd", 1, ("http ", "https ")),
        ("to ftp://127.0.0.1/x", 1, ("http ", "https ")),
    ],
)  # fmt: skip
def test_a_file_that_fails_leaves_nothing_of_itself(
    claw: Asset, server: Server, cache: Path, fault: str | int, attempts: int, named: tuple[str, ...]
):
    server.faults[MIDDLE] = fault
    assert_names(refusal(claw, server), "hands/claw", "meshes/tip.obj", *named)
    assert server.asked[MIDDLE] == attempts
    # Those that were whole stay.
    folder = asset_folder(claw, "mirror")
    assert files_in(cache) == {
        (folder / name).relative_to(cache).as_posix(): CONTENTS[name] for name in ("claw.urdf", "meshes/palm.obj")
    }
    assert not is_whole(claw, "mirror")
    # The next try goes on there.
    server.faults.clear()
    server.asked.clear()
    assert files_in(fetch(claw, server)) == CONTENTS
    assert server.asked == {MIDDLE: 1}


@pytest.mark.parametrize("faults", [["cut"], ["cut", 500], ["short"], [503, "wrong"], [429]])
def test_a_connection_that_breaks_once_is_made_again(claw: Asset, server: Server, faults: list):
    server.faults[MIDDLE] = list(faults)
    assert files_in(fetch(claw, server)) == CONTENTS
    assert server.asked[MIDDLE] == len(faults) + 1


def test_nobody_answers(claw: Asset, cache: Path):
    with socket.socket() as waiting:
        waiting.bind(("127.0.0.1", 0))  # bound, but it does not listen
        address = f"127.0.0.1:{waiting.getsockname()[1]}"
        named = ("hands/claw", "claw.urdf", address, "Connection refused", f"{MAX_ATTEMPTS} times")
        ways_out = ("GRASP_REFINE_ASSETS=FOLDER", "GRASP_REFINE_ASSETS=https://...")
        with refused(AssetError, *named, *ways_out) as caught:
            fetch_asset(claw, Mirror(f"http://user:secret@{address}"), pause=0.01)
        assert "secret" not in str(caught.value)
    assert not cache.exists()


def test_a_folder_with_another_file_or_without_one_is_refused(claw: Asset, tmp_path: Path, cache: Path):
    mirror = made_tree(tmp_path / "mirror")
    (mirror / "claw/claw.urdf").write_bytes(b"y" * len(CONTENTS["claw.urdf"]))
    with refused(AssetError, "mirror/claw/claw.urdf", "sha256"):
        fetch_asset(claw, Mirror(mirror))
    (mirror / "claw/claw.urdf").write_bytes(b"y" * 200_000)
    with refused(AssetError, "claw.urdf", "21 bytes"):
        fetch_asset(claw, Mirror(mirror))
    (mirror / "claw/claw.urdf").unlink()
    with refused(AssetError, "hands/claw", mirror / "claw/claw.urdf"):
        fetch_asset(claw, Mirror(mirror))
    assert not cache.exists()


@pytest.mark.parametrize("place", ["../x", "/etc/passwd", "a/../../../x", "a\\..\\x", "", "../../../../../x"])
def test_a_place_outside_of_the_cache_is_refused(claw: Asset, place: str):
    with refused(AssetError, f"'{place}'"):
        path_inside(asset_folder(claw, "mirror"), place)


@pytest.mark.parametrize("link", ["hands", "hands/claw", "FOLDER", "FOLDER/meshes", "FOLDER/meshes/tip.obj"])
def test_nothing_is_written_or_read_through_a_link(claw: Asset, server: Server, cache: Path, tmp_path: Path, link: str):
    outside = tmp_path / "outside"
    outside.mkdir()
    name = asset_folder(claw, "mirror").relative_to(cache).as_posix()
    place = cache / link.replace("FOLDER", name)
    place.parent.mkdir(parents=True)
    place.symlink_to(outside / "tip.obj" if place.suffix else outside)
    with refused(AssetError, place, "link"):
        fetch(claw, server)
    assert not any(outside.iterdir())
    if place.is_relative_to(asset_folder(claw, "mirror")) or place.suffix:
        (verdict,) = verify([claw])
        assert verdict.state == "damaged" and "link" in verdict.reason


@pytest.mark.parametrize("terms", ["non-commercial", "unclear"])
def test_a_licence_that_restricts_is_accepted_first(tmp_path: Path, server: Server, terms: str, cache: Path):
    claw = made_asset(tmp_path / "manifest", terms=terms, licence="some words")
    with refused(AssetError, "some words", "assets fetch hands/claw `accept_license`"):
        fetch(claw, server)
    assert not server.asked and not cache.exists()
    folder = fetch(claw, server, accept_license=True)
    record = json.loads((folder.parent / "accepted.json").read_text())
    assert record["licence"] == "some words" and record["asset"] == "hands/claw"
    # It is remembered, for these words.
    (folder / "claw.urdf").unlink()
    fetch(claw, server)
    assert is_accepted(claw)
    assert not is_accepted(made_asset(tmp_path / "newer", terms=terms, licence="other words"))


@pytest.fixture
def packaged(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Asset:
    """The made-up hand out of a Python package, which is installed."""
    site = tmp_path / "site"
    for name, content in CONTENTS.items():
        (site / name).parent.mkdir(parents=True, exist_ok=True)
        (site / name).write_bytes(content)
    info = site / "claws-1.2.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: claws\nVersion: 1.2\n")
    monkeypatch.syspath_prepend(str(site))
    made_asset(tmp_path / "manifest")
    text = (tmp_path / "manifest/hands.toml").read_text()
    text = re.sub("repository = .*\ncommit = .*\n", 'package = "claws==1.2"\n', text)
    (tmp_path / "packaged").mkdir()
    (tmp_path / "packaged/hands.toml").write_text(text)
    return read_manifest("hands", tmp_path / "packaged")["claw"]


def test_files_of_an_installed_package_are_copied(packaged: Asset, tmp_path: Path):
    assert files_in(fetch_asset(packaged, Upstream())) == CONTENTS
    (tmp_path / "site/claw.urdf").write_text("other")
    (asset_folder(packaged, "upstream") / "claw.urdf").unlink()
    with refused(AssetError, "site/claw.urdf", "sha256"):
        fetch_asset(packaged, Upstream())


def test_a_package_of_another_version_or_none_says_how_to_install_it(packaged: Asset, tmp_path: Path):
    (tmp_path / "site/claws-1.2.dist-info/METADATA").write_text("Metadata-Version: 2.1\nName: claws\nVersion: 1.3\n")
    with refused(AssetError, "claws==1.2", "1.3", "pip install --no-deps claws=="):
        fetch_asset(packaged, Upstream())
    (tmp_path / "site/claws-1.2.dist-info/METADATA").unlink()
    (tmp_path / "site/claws-1.2.dist-info").rmdir()
    with refused(AssetError, "pip install --no-deps claws==1.2"):
        fetch_asset(packaged, Upstream())


def test_what_upstream_has_in_another_form_needs_a_mirror():
    with refused(AssetError, "hands/robotiq3f", "robotiq3f.urdf", "cfg/", ".xacro"):
        fetch_asset(read_manifest("hands")["robotiq3f"], Upstream())


def test_locating_fetches_what_is_open(claw: Asset, server: Server, monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    monkeypatch.setenv("GRASP_REFINE_ASSETS", server.address + "/")
    with refused(AssetError, "refine-grasp assets fetch hands/claw"):
        locate_asset(claw, fetch=False)
    path = locate_asset(claw)
    assert path == asset_folder(claw, "mirror") / "claw.urdf" and is_whole(claw, "mirror")
    assert locate_asset(claw, fetch=False) == path
    path.write_bytes(b"damaged")
    with refused(AssetError, "refine-grasp assets fetch hands/claw"):
        locate_asset(claw, fetch=False)
    assert locate_asset(claw).read_bytes() == CONTENTS["claw.urdf"]
    restricted = made_asset(tmp_path / "restricted", terms="non-commercial", licence="CC BY-NC 4.0")
    assert locate_asset(restricted) == path  # the same files are here: nothing is fetched
    path.unlink()
    with refused(AssetError, "refine-grasp assets fetch hands/claw `accept_license`"):
        locate_asset(restricted)


@pytest.mark.parametrize(
    "named", ["ftp://127.0.0.1/x", "file:///tmp", "nowhere", "http://", "https://h/x?y=1", "http://h/#x"]
)
def test_a_mirror_is_a_folder_or_a_web_address(claw: Asset, monkeypatch: pytest.MonkeyPatch, named: str):
    monkeypatch.setenv("GRASP_REFINE_ASSETS", named)
    with refused(AssetError, f"GRASP_REFINE_ASSETS={named}", "http://"):
        locate_asset(claw)


FETCH = """
import sys
from grasp_refine.assets.fetching import fetch_asset
from grasp_refine.assets.names import choose_asset
for name in sys.argv[1:]:
    fetch_asset(choose_asset(name), accept_license=True)
"""


def test_all_assets_come_from_the_shared_folder(shared_assets: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("GRASP_REFINE_ASSETS", str(shared_assets))
    assets = [asset for asset in all_assets() if (shared_assets / asset.files[0].mirror).exists()]
    assert len(assets) == 8 + 61 + 6
    for asset in assets:
        fetch_asset(asset, accept_license=True)
        path = locate_asset(asset, fetch=False)
        assert path.is_dir() if asset.kind == "grasps" else path.is_file()
        if asset.kind == "objects":
            assert path.stem == asset.name
    verdicts = list(verify(assets))
    assert [verdict.state for verdict in verdicts] == ["whole"] * len(assets)
    assert sum(verdict.files for verdict in verdicts) == sum(len(asset.files) for asset in assets)


def test_two_processes_that_fetch_at_once_end_with_whole_files(shared_assets: Path, monkeypatch: pytest.MonkeyPatch):
    names = ["hands/barrett", "grasps/bodex_shadow_objects"]
    with serving(shared_assets) as server:
        monkeypatch.setenv("GRASP_REFINE_ASSETS", server.address)
        command = [sys.executable, "-c", FETCH, *names]
        running = [
            subprocess.Popen(command, env=subprocess_environment(), stderr=subprocess.PIPE, text=True) for _ in range(2)
        ]
        said = [process.communicate(timeout=PATIENCE_S)[1] for process in running]
        assert [process.returncode for process in running] == [0, 0], said
    for kind, name in (name.split("/") for name in names):
        asset = read_manifest(kind)[name]
        assert is_whole(asset, "mirror")
        here = files_in(asset_folder(asset, "mirror"))
        assert set(here) == {file.mirror_place for file in asset.files}, "no temporary files"
