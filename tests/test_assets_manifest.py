"""The manifests of other people's assets: complete, well formed, and nothing that leaves a folder."""

from __future__ import annotations

import hashlib
import re
import tomllib
from collections.abc import Iterator
from pathlib import Path, PurePosixPath

import pytest

from grasp_refine.assets import resource_dir

KINDS = ("hands", "objects", "grasps")


def entries(kind: str) -> dict[str, dict]:
    return tomllib.loads((resource_dir("assets_manifest") / f"{kind}.toml").read_text(encoding="utf-8"))


def files(entry: dict) -> Iterator[dict]:
    """The files of an entry, each with its own source, place in the mirror folder and hash there."""
    listed = entry.get("files", [entry])
    for file in listed:
        mirror = file["mirror"] if file is entry else f"{entry['mirror']}/{file.get('mirror', file['path'])}"
        yield {
            **file,
            "mirror": mirror,
            "commit": None if "package" in file else entry["commit"],
            "mirror_sha256": file.get("mirror_sha256", file.get("sha256")),
        }


@pytest.mark.parametrize(("kind", "count"), [("hands", 8), ("objects", 61), ("grasps", 6)])
def test_every_entry_says_source_licence_and_unit(kind: str, count: int):
    assert len(entries(kind)) == count
    for name, entry in entries(kind).items():
        assert entry["licence"] and entry["unit"], name
        assert ("package" in entry) != ("repository" in entry), name
        if "repository" in entry:
            assert re.fullmatch(r"https://github\.com/[\w.-]+/[\w.-]+", entry["repository"]), name
            assert re.fullmatch(r"[0-9a-f]{40}", entry["commit"]), name
        else:
            assert re.fullmatch(r"[\w-]+==[\w.]+", entry["package"]), name


@pytest.mark.parametrize("kind", KINDS)
def test_every_file_has_hashes_and_says_how_the_mirrored_copy_differs(kind: str):
    for name, entry in entries(kind).items():
        for file in files(entry):
            for key in ("sha256", "mirror_sha256"):
                assert re.fullmatch(r"[0-9a-f]{64}", file.get(key, file["mirror_sha256"])), (name, file)
            assert ("changed" in file) == (file.get("sha256") != file["mirror_sha256"]), (name, file)


@pytest.mark.parametrize("kind", KINDS)
def test_no_path_leaves_its_folder(kind: str):
    for name, entry in entries(kind).items():
        for file in files(entry):
            for path in (entry.get("folder", "."), entry["mirror"], file["path"], file["mirror"]):
                pure = PurePosixPath(path)
                assert not pure.is_absolute() and ".." not in pure.parts, (name, path)
                assert "\\" not in path and ":" not in path, (name, path)


@pytest.mark.parametrize("kind", KINDS)
def test_no_two_files_share_a_place_in_the_mirror(kind: str):
    places = [file["mirror"] for entry in entries(kind).values() for file in files(entry)]
    assert len(places) == len(set(places))


def test_grasp_sets_name_their_hand():
    sets = [entry for name, entry in entries("grasps").items() if not name.endswith("_objects")]
    assert {entry["hand"] for entry in sets} <= set(entries("hands"))
    assert all(entry["format"] for entry in sets)


def test_objects_have_a_positive_scale():
    assert all(entry["scale"] > 0 for entry in entries("objects").values())


@pytest.mark.parametrize("kind", KINDS)
def test_the_shared_folder_is_a_mirror(shared_assets: Path, kind: str):
    for name, entry in entries(kind).items():
        for file in files(entry):
            content = (shared_assets / file["mirror"]).read_bytes()
            assert hashlib.sha256(content).hexdigest() == file["mirror_sha256"], (name, file["path"])
