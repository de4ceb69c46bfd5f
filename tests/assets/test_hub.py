"""Grasps of the Hugging Face Hub, out of a cache as huggingface_hub lays it out, without a network."""

import json
from pathlib import Path

import numpy as np
import pytest

from grasp_refine.assets.hub import hub_dataset
from grasp_refine.core.errors import AssetError
from grasp_refine_apps.cli import main
from refusals import refused

COMMIT = "0123456789abcdef0123456789abcdef01234567"
CARD = "---\nlicense: {}\ntags:\n- grasping\n---\n# Grasps\n"


@pytest.fixture
def hub(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The cache of a machine that has fetched data sets, and is offline now."""
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")
    monkeypatch.setenv("HF_HUB_CACHE", str(tmp_path / "hub"))
    monkeypatch.setenv("GRASP_REFINE_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr("huggingface_hub.constants.HF_HUB_OFFLINE", True)
    monkeypatch.setattr("huggingface_hub.constants.HF_HUB_CACHE", str(tmp_path / "hub"))
    monkeypatch.chdir(tmp_path)
    return tmp_path / "hub"


def add(hub: Path, name: str, card: str) -> None:
    """A data set with two grasps of a table, each file a link to a blob, as in that cache."""
    folder = hub / f"datasets--{name.replace('/', '--')}"
    snapshot, blobs = folder / "snapshots" / COMMIT, folder / "blobs"
    for place in (folder / "refs", blobs, snapshot / "grasps"):
        place.mkdir(parents=True)
    (folder / "refs/main").write_text(COMMIT)
    mapping = 'table = "grasps.csv"\nbase_link = "palm"\nhand = "mine"\nposition = ["x", "y", "z"]\n'
    mapping += 'rotation = ["qw", "qx", "qy", "qz"]\n[joints]\nknuckle = "k"\n'
    files = {"README.md": card, "grasps/mine.toml": mapping, "notes.txt": "x"}
    files["grasps/grasps.csv"] = "x,y,z,qw,qx,qy,qz,k\n0.1,0,0,1,0,0,0,0.5\n0,0.2,0,0,1,0,0,0.7\n"
    for number, (path, text) in enumerate(files.items()):
        (blobs / f"{number:040x}").write_text(text)
        (snapshot / path).symlink_to(blobs / f"{number:040x}")


def test_open_grasps_are_read_by_name(hub: Path, capfd: pytest.CaptureFixture[str]):
    add(hub, "someone/grasps", CARD.format("cc-by-4.0"))
    assert main(["convert", "hf://someone/grasps/grasps", "out.npz", "--to", "ours"]) == 0
    assert "cc-by-4.0 (open)" in capfd.readouterr().err
    with np.load("out.npz") as file:
        np.testing.assert_allclose(file["q"][:, 0], [0.5, 0.7])
    assert main(["assets", "fetch", "hf://someone/grasps", "--json", "facts.json"]) == 0
    facts = json.loads(Path("facts.json").read_text())["assets"][0]
    assert facts["terms"] == "open" and Path(facts["path"]).name == COMMIT


def test_a_licence_that_restricts_use_is_asked_for_once(hub: Path, capfd: pytest.CaptureFixture[str]):
    add(hub, "someone/research", CARD.format("cc-by-nc-4.0"))
    words = ("convert", "hf://someone/research/grasps/mine.toml", "out.npz", "--to", "ours")
    assert main([*words]) == 2
    said = capfd.readouterr().err
    assert "cc-by-nc-4.0" in said and "assets fetch hf://someone/research --accept-license" in said
    assert main(["assets", "fetch", "hf://someone/research"]) == 2
    assert main(["assets", "fetch", "hf://someone/research", "--accept-license"]) == 0
    assert "cc-by-nc-4.0 (non-commercial)" in capfd.readouterr().out
    assert main([*words]) == 0


@pytest.mark.parametrize(
    ("card", "terms"),
    [
        (CARD.format("mit"), "open"),
        (CARD.format("cc-by-nc-sa-4.0"), "non-commercial"),
        (CARD.format("other\nlicense_name: my-own"), "unclear"),
        (CARD.format("[mit, cc-by-nc-4.0]"), "non-commercial"),
        (CARD.format("&a [*a]"), "unclear"),
        ("# No facts", "unclear"),
        ("---\nlicense: [\n---\n", "unclear"),
    ],
)
def test_terms_follow_from_the_card(card: str, terms: str, hub: Path):
    add(hub, "someone/grasps", card)
    assert hub_dataset("hf:/someone/grasps", lambda line: None).terms == terms


@pytest.mark.parametrize("name", ["hf:/someone", "hf:/", "hf:/../x", "hf:/a/b/../../c", "hf:/a b/c"])
def test_names_that_are_none_are_refused(name: str, hub: Path):
    with refused(AssetError, "hf://OWNER/NAME"):
        hub_dataset(name, lambda line: None)


def test_what_is_not_in_the_cache_is_refused_offline(hub: Path):
    with refused(AssetError, "hf://someone/else", "cache"):
        hub_dataset("hf:/someone/else", lambda line: None)
