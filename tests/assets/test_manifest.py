"""The manifests of other people's assets: complete, well formed, and nothing that leaves a folder."""

import copy
import hashlib
import json
import re
import tomllib
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path, PurePosixPath

import jsonschema
import pytest

from grasp_refine.assets.embedded import resource_dir
from grasp_refine.assets.manifest import KINDS as KNOWN_KINDS
from grasp_refine.assets.manifest import read_manifest
from grasp_refine.core.errors import AssetError
from refusals import refused

KINDS = ("hands", "objects", "grasps")
MODELS = (
    "ability_{}",
    "allegro_v5_{}",
    "dex3_{}",
    "dg5f_{}",
    "inspire_{}",
    "orca_{}",
    "sharpa_{}_mjcf",
    "wuji_{}_mjcf",
)
MODELS += ("xhand_{}",)
NOT_MIRRORED = {"linkerhand_o7_right", *(model.format(side) for model in MODELS for side in ("left", "right"))}
"""Hands that the shared folder does not have."""


@cache
def parsed(kind: str) -> dict[str, dict]:
    return tomllib.loads((resource_dir("assets_manifest") / f"{kind}.toml").read_text(encoding="utf-8"))


def entries(kind: str) -> dict[str, dict]:
    return copy.deepcopy(parsed(kind))


def few() -> dict[str, dict[str, dict]]:
    """A document of one entry of each kind, which is quicker to validate."""
    names = {"hands": "allegro", "objects": "ycb_011_banana", "grasps": "leap_cube"}
    return {kind: {name: copy.deepcopy(parsed(kind)[name])} for kind, name in names.items()}


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


@pytest.mark.parametrize("kind", KINDS)
def test_the_shared_folder_is_a_mirror(shared_assets: Path, kind: str):
    known = {name: entry for name, entry in entries(kind).items() if name not in NOT_MIRRORED}
    for name, entry in known.items():
        for file in files(entry):
            content = (shared_assets / file["mirror"]).read_bytes()
            assert hashlib.sha256(content).hexdigest() == file["mirror_sha256"], (name, file["path"])


@pytest.mark.parametrize("kind", KINDS)
def test_terms_follow_from_the_words_of_the_licence(kind: str):
    for name, entry in entries(kind).items():
        words = entry["licence"]
        if "BY-NC" in words or "research terms" in words:
            assert entry["terms"] == "non-commercial", name
        elif any(doubt in words for doubt in ("unclear", "not stated", "conflict", "no repo LICENSE", "no LICENSE")):
            assert entry["terms"] == "unclear", name
        else:
            assert entry["terms"] == "open" and re.search(r"MIT|BSD|Apache|CC BY 4\.0", words), name


@pytest.fixture(scope="module")
def validator() -> jsonschema.Draft202012Validator:
    schema = json.loads((resource_dir("assets_manifest") / "schema.json").read_text(encoding="utf-8"))
    jsonschema.Draft202012Validator.check_schema(schema)
    return jsonschema.Draft202012Validator(schema)


def test_the_manifests_fit_their_schema(validator: jsonschema.Draft202012Validator):
    assert KINDS == KNOWN_KINDS
    document = {kind: entries(kind) for kind in KINDS}
    assert [f"{error.json_path}: {error.message}" for error in validator.iter_errors(document)] == []


@pytest.mark.parametrize("kind", KINDS)
def test_the_program_reads_what_the_manifests_say(kind: str):
    assets = read_manifest(kind)
    assert len(assets) == {"hands": 27, "objects": 61, "grasps": 6}[kind]
    assert list(assets) == list(entries(kind))
    for name, entry in entries(kind).items():
        asset = assets[name]
        told = (asset.licence, asset.terms, asset.citation, asset.unit, asset.scale)
        assert told == tuple(entry[key] for key in ("licence", "terms", "citation", "unit", "scale"))
        assert [file.mirror for file in asset.files] == [file["mirror"] for file in files(entry)]
        assert [file.mirror_sha256 for file in asset.files] == [file["mirror_sha256"] for file in files(entry)]
        assert [file.sha256 for file in asset.files] == [file.get("sha256") for file in files(entry)]
    if kind == "hands":
        ends = {name: PurePosixPath(asset.main.mirror_place).suffix for name, asset in assets.items()}
        assert ends == {name: ".xml" if name.endswith("_mjcf") else ".urdf" for name in ends}


def remove(*keys: str) -> Callable[[dict], None]:
    def change(entry: dict) -> None:
        for key in keys:
            del entry[key]

    return change


def put(**values: object) -> Callable[[dict], None]:
    return lambda entry: entry.update(values)


def put_in_file(**values: object) -> Callable[[dict], None]:
    return lambda entry: entry["files"][0].update(values)


BAD = {
    "no licence": (remove("licence"), "licence = None"),
    "empty citation": (put(citation=""), "citation = ''"),
    "no terms": (remove("terms"), "terms = None"),
    "other terms": (put(terms="free"), "terms = 'free'", "open, non-commercial, unclear"),
    "no unit": (remove("unit"), "unit = None"),
    "no scale": (remove("scale"), "scale = None"),
    "scale zero": (put(scale=0.0), "scale = 0.0"),
    "no source": (remove("repository", "commit"), "repository", "package"),
    "two sources": (put(package="a==1"), "repository", "package"),
    "other host": (put(repository="http://example.org/a/b"), "repository = 'http://example.org/a/b'", "https"),
    "short commit": (put(commit="93505db"), "commit = '93505db'"),
    "no files": (put(files=[]), "files"),
    "no main": (remove("main"), "main = None"),
    "folder above": (put(folder="a/../.."), "folder = 'a/../..'"),
    "mirror above": (put(mirror="../hands"), "mirror = '../hands'"),
    "absolute path": (put_in_file(path="/etc/passwd"), "path = '/etc/passwd'"),
    "path above": (put_in_file(path="meshes/../../x"), "path = 'meshes/../../x'"),
    "place above": (put_in_file(place="../x"), "place = '../x'"),
    "mirror of file above": (put_in_file(mirror="x/.."), "mirror = 'x/..'"),
    "backslash": (put_in_file(place="a\\..\\b"), "place = 'a\\\\..\\\\b'"),
    "drive": (put_in_file(place="C:/x"), "place = 'C:/x'"),
    "dots and spaces": (put_in_file(place="a/.. /b"), "place = 'a/.. /b'"),
    "line break": (put_in_file(place="a\nb"), "place = 'a\\nb'"),
    "here": (put_in_file(place="./x"), "place = './x'"),
    "empty part": (put_in_file(place="a//x"), "place = 'a//x'"),
    "short hash": (put_in_file(sha256="cd51"), "sha256 = 'cd51'"),
    "capital hash": (put_in_file(sha256="A" * 64), f"sha256 = '{'A' * 64}'"),
    "negative size": (put_in_file(bytes=-1), "bytes = -1"),
    "changed without hash": (put_in_file(changed="decimated"), "mirror_sha256 = None"),
    "package without version": (put_in_file(package="playground"), "package = 'playground'"),
}
"""Fault -> what makes it, and what the refusal must name."""


@pytest.mark.parametrize("fault", BAD)
def test_a_manifest_that_is_wrong_is_refused(fault: str, validator: jsonschema.Draft202012Validator, tmp_path: Path):
    change, *named = BAD[fault]
    document = few()
    change(document["hands"]["allegro"])
    assert list(validator.iter_errors(document)), "the schema"
    write(tmp_path / "hands.toml", document["hands"])
    with refused(AssetError, "hands.toml", "hands/allegro", *named):
        read_manifest("hands", tmp_path)


@pytest.mark.parametrize("name", ["..", ".hidden", "a/b", "a b", "-x", "a..b", "\u00fc"])
def test_a_name_is_a_folder_name(name: str, validator: jsonschema.Draft202012Validator, tmp_path: Path):
    document = few()
    document["hands"][name] = document["hands"].pop("allegro")
    assert list(validator.iter_errors(document))
    write(tmp_path / "hands.toml", document["hands"])
    with refused(AssetError, tmp_path / "hands.toml", name, "'_', '-'", "'.'"):
        read_manifest("hands", tmp_path)


def test_two_files_at_one_place_are_refused(tmp_path: Path):
    hands = few()["hands"]
    hands["allegro"]["files"][1]["place"] = hands["allegro"]["files"][0]["path"].upper()
    write(tmp_path / "hands.toml", hands)
    with refused(AssetError, "hands/allegro", "'MESHES/COLLISION/LINK_TIP.OBJ'"):
        read_manifest("hands", tmp_path)


def test_an_unknown_key_does_not_fit_the_schema(validator: jsonschema.Draft202012Validator):
    document = few()
    document["objects"]["ycb_011_banana"]["license"] = "MIT"
    document["grasps"]["leap_cube"]["files"][0]["sha265"] = "0" * 64
    assert {error.absolute_path[1] for error in validator.iter_errors(document)} == {"ycb_011_banana", "leap_cube"}


def test_a_manifest_that_is_missing_or_no_toml_is_refused(tmp_path: Path):
    with refused(AssetError, tmp_path / "hands.toml", "No such file"):
        read_manifest("hands", tmp_path)
    (tmp_path / "objects.toml").write_text("[a\n")
    with refused(AssetError, tmp_path / "objects.toml"):
        read_manifest("objects", tmp_path)
    (tmp_path / "grasps.toml").write_text("a = 1\n")
    with refused(AssetError, "grasps/a", "[a]"):
        read_manifest("grasps", tmp_path)


def write(path: Path, document: dict[str, dict]) -> None:
    """Write entries as TOML."""
    lines = []
    for name, entry in document.items():
        lines.append(f"[{json.dumps(name)}]")
        lines += [f"{key} = {inline(value)}" for key, value in entry.items()]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def inline(value: object) -> str:
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{key} = {inline(one)}" for key, one in value.items()) + " }"
    if isinstance(value, list):
        return "[" + ", ".join(map(inline, value)) + "]"
    return json.dumps(value)


@pytest.mark.parametrize(
    ("change", "named"),
    [
        (put_in_file(bytes=2**63), "bytes = 9223372036854775808"),
        (put(citation="\x1b[2J"), "citation = '\\x1b[2J'"),
        (put_in_file(place="a\x9bb"), "place = 'a\\x9bb'"),
    ],
)
def test_what_the_schema_does_not_see_is_refused(change: Callable[[dict], None], named: str, tmp_path: Path):
    document = few()
    change(document["hands"]["allegro"])
    write(tmp_path / "hands.toml", document["hands"])
    with refused(AssetError, "hands.toml", "hands/allegro", named):
        read_manifest("hands", tmp_path)
