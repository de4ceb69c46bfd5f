"""Manifests of assets, and what is found in the cache by them."""

from __future__ import annotations

import tomllib
from collections.abc import Hashable
from functools import cache
from pathlib import Path
from random import Random

from fuzz.reader import Reader, plain
from fuzz.toml import WORDS, changed_toml, toml
from grasp_refine.assets import manifest
from grasp_refine.assets.cache import LAYOUTS, asset_folder, main_path, path_inside
from grasp_refine.assets.embedded import resource_dir
from grasp_refine.assets.licence import RECORD, is_accepted
from grasp_refine.assets.manifest import read_manifest
from grasp_refine.assets.origin import wanted
from grasp_refine.assets.verifying import verify

NAMES = {"hands": "allegro", "objects": "ycb_011_banana", "grasps": "leap_cube"}
PLACES = ("a/../b", "../../x", "/x", "a//b", "./a", "a/.", "C:/x", "a\\b", ".. /x", "a\x85b", "a" * 250, "a/b/c")


@cache
def seeds() -> tuple[tuple[str, bytes], ...]:
    """An entry of each kind, of ours."""
    found = []
    for kind, name in NAMES.items():
        entries = tomllib.loads((resource_dir("assets_manifest") / f"{kind}.toml").read_text(encoding="utf-8"))
        if "files" in entries[name]:
            entries[name]["files"] = entries[name]["files"][:3]
            if kind == "hands":
                entries[name]["main"] = entries[name]["files"][0]["path"]
        entries[name]["terms"] = "unclear"
        found.append((f"{kind}.toml", toml({name: entries[name]})))
    return (*found, ("record/accepted.json", b'{"asset": "hands/x", "licence": "MIT", "terms": "unclear"}'))


def change(random: Random, name: str, content: bytes) -> bytes:
    """Another value in an entry, often a place that leads elsewhere."""
    if name.endswith(".json"):
        cut = content[: random.randrange(len(content) + 1)]
        return random.choice((b"[" * 30000, b"[]", b"1", b"{", cut, b"9" * 5000))
    return changed_toml(PLACES)(random, name, content)


def read(path: Path) -> Hashable:
    """The assets, where they would lie, and whether they are there; of a record, whether it says yes."""
    if path.name == RECORD:
        return _accepted(path)
    manifest._read.cache_clear()
    assets = read_manifest(path.stem, path.parent)
    for asset in assets.values():
        for layout in LAYOUTS:
            folder = asset_folder(asset, layout)
            for file in asset.files:
                place = path_inside(folder, wanted(file, layout).place)
                assert place.resolve().is_relative_to(folder.resolve()), place
            main_path(asset, layout)
        for text in (asset.name, asset.full_name, asset.licence, asset.citation, asset.unit, asset.note, asset.source):
            plain(text)
        is_accepted(asset)
    return len(assets), len(list(verify(assets.values())))


def _accepted(path: Path) -> Hashable:
    manifest._read.cache_clear()
    folder = path.parent.parent
    (folder / "hands.toml").write_bytes(dict(seeds())["hands.toml"])
    (asset,) = read_manifest("hands", folder).values()
    record = folder / "cache" / "assets" / asset.kind / asset.name / RECORD
    record.parent.mkdir(parents=True, exist_ok=True)
    record.write_bytes(path.read_bytes())
    return is_accepted(asset)


READER = Reader(
    "manifest",
    seeds,
    read,
    change,
    (
        *WORDS,
        *(v.encode() for v in PLACES),
    ),
)
