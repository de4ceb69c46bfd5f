"""A checkout, the wheel, the wheel built from the sdist and an editable install hold both packages and their data.

All but one are built where no C++ compiler works, which leaves the compiled engine out.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from collections.abc import Iterable
from pathlib import Path

import pytest

from command_line import subprocess_environment
from git_repository import commit_all
from grasp_refine.core.source_version import source_version
from refusals import refused

pytest.importorskip("scikit_build_core", reason="the build backend comes with the extra 'test'")

ROOT = Path(__file__).resolve().parents[1]
PLACES = {
    "grasp_refine": "grasp_refine",
    "apps/grasp_refine_apps": "grasp_refine_apps",
    "robots": "grasp_refine/robots",
    "assets_manifest": "grasp_refine/assets_manifest",
}
"""Folders of the repository, and their places in the wheel."""

SOURCES = "grasp_refine/collision/native"
"""Of the compiled engine: they are in the sdist only."""


def build(source: Path, hook: str, target: Path, compiler: str | None = "/no/compiler") -> Path:
    """Call a hook of the build backend on `source`, as pip does, without fetching anything.

    `compiler` is the C++ compiler; None: whichever there is.
    """
    code = f"import scikit_build_core.build as b, sys; sys.stdout = sys.stderr; b.{hook}({str(target)!r})"
    target.mkdir()
    environment = os.environ | ({"CXX": compiler} if compiler else {})
    result = subprocess.run([sys.executable, "-c", code], cwd=source, env=environment, capture_output=True, text=True)
    assert result.returncode == 0, result.stderr
    (built,) = target.iterdir()
    return built


def wanted(source: Path) -> set[str]:
    """Names that the files of `source` have in the wheel."""
    return {
        str(place / path.relative_to(source / folder))
        for folder, place in PLACES.items()
        for path in (source / folder).rglob("*")
        if path.is_file() and "__pycache__" not in path.parts and source / SOURCES not in path.parents
    }


def contents(wheel: Path) -> set[str]:
    with zipfile.ZipFile(wheel) as archive:
        return {name for name in archive.namelist() if ".dist-info/" not in name}


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the sources: building in the checkout would leave files there."""
    copy = tmp_path_factory.mktemp("source")
    for name in ("pyproject.toml", "README.md", "CONTRIBUTING.md", "CITATION.cff", "LICENSE", ".gitignore"):
        shutil.copy(ROOT / name, copy)
    for folder in PLACES:
        shutil.copytree(ROOT / folder, copy / folder, ignore=shutil.ignore_patterns("__pycache__"))
    commit_all(copy)
    return copy


@pytest.fixture(scope="module")
def version(source: Path) -> str:
    """Version of `source`, with its commit."""
    found = source_version(source)
    assert re.fullmatch(r"0\.2\.0\+g[0-9a-f]{7,}", found)
    return found


@pytest.fixture(scope="module")
def wheel(source: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel without the compiled engine."""
    return build(source, "build_wheel", tmp_path_factory.mktemp("wheel") / "built")


@pytest.fixture(scope="module")
def checkout(source: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the sources to be installed as an editable."""
    return shutil.copytree(source, tmp_path_factory.mktemp("checkout") / "source")


@pytest.fixture(scope="module")
def editable(checkout: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel of an editable install of `checkout`."""
    return build(checkout, "build_editable", tmp_path_factory.mktemp("editable") / "built")


def test_the_wheel_holds_both_packages_with_their_data(source: Path, wheel: Path, version: str):
    assert wheel.name == f"grasp_refine-{version}-py3-none-any.whl"
    assert contents(wheel) == wanted(source)
    typed = {f"{package}/py.typed" for package in ("grasp_refine", "grasp_refine_apps")}
    assert typed | {"grasp_refine_apps/__init__.py"} <= contents(wheel)
    for kind in ("hands", "objects", "grasps"):
        assert f"grasp_refine/assets_manifest/{kind}.toml" in contents(wheel)
    assert any(name.startswith("grasp_refine/robots/allegro/") for name in contents(wheel))


def test_the_wheel_names_its_command_and_licence(wheel: Path):
    with zipfile.ZipFile(wheel) as archive:
        info = {Path(name).name: name for name in archive.namelist() if ".dist-info/" in name}
        commands = archive.read(info["entry_points.txt"]).decode().replace(" ", "")
        assert "refine-grasp=grasp_refine_apps.cli:main" in commands
        metadata = archive.read(info["METADATA"]).decode()
        assert "License-Expression: Apache-2.0" in metadata
        assert "Requires-Python: >=3.11" in metadata
        assert b"Apache License" in archive.read(info["LICENSE"])


def test_the_sdist_builds_the_same_wheel(source: Path, wheel: Path, tmp_path: Path):
    """The sdist has no repository, and carries the version with the commit."""
    sdist = build(source, "build_sdist", tmp_path / "sdist")
    with tarfile.open(sdist) as archive:
        archive.extractall(tmp_path / "unpacked", filter="data")
    (unpacked,) = (tmp_path / "unpacked").iterdir()
    assert {path.name for path in (unpacked / SOURCES).iterdir()} >= {"CMakeLists.txt", "module.cpp", "search.h"}
    assert {path.name for path in unpacked.iterdir()} >= {"README.md", "CONTRIBUTING.md", "CITATION.cff", "LICENSE"}
    again = build(unpacked, "build_wheel", tmp_path / "wheel")
    assert again.name == wheel.name and contents(again) == wanted(source)


OFFLINE = ("No matching distribution found", "Temporary failure in name resolution", "Connection")
"""What pip says where it can fetch nothing."""


@pytest.mark.slow
def test_the_sdist_installs_in_an_empty_environment(source: Path, version: str, tmp_path: Path):
    """As on a machine of somebody else: pip builds it and fetches what it declares to need, nothing of ours is near."""
    sdist = build(source, "build_sdist", tmp_path / "sdist")
    home = tmp_path / "home"
    environment = {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "GRASP_REFINE"))}
    environment["GRASP_REFINE_CACHE"] = str(tmp_path / "cache")

    def call(*words: str | Path) -> subprocess.CompletedProcess[str]:
        return subprocess.run(list(map(str, words)), cwd=home, env=environment, capture_output=True, text=True)

    home.mkdir()
    assert call(sys.executable, "-m", "venv", home / "venv").returncode == 0
    result = call(home / "venv/bin/pip", "install", sdist)
    if result.returncode != 0 and any(words in result.stderr for words in OFFLINE):
        pytest.skip(f"pip can fetch nothing here: {result.stderr.splitlines()[-1]}")
    assert result.returncode == 0, result.stderr
    assert call(home / "venv/bin/pip", "check").returncode == 0, "what is installed fits together"
    program = home / "venv/bin/refine-grasp"
    assert call(program, "--version").stdout == f"refine-grasp {version}\n"
    run = call(program, "run", "--geometry-only")
    assert run.returncode == 0, run.stderr
    assert "4 of 4" in run.stdout
    assert (home / "grasp-refine-results/allegro_mug.npz").is_file()
    checked = call(program, "doctor")
    assert checked.returncode == 0 and f"grasp-refine {version} " in checked.stdout
    listed = call(program, "hands")
    assert listed.returncode == 0 and "shadow_palm" in listed.stdout


def imported(*modules: str, paths: Iterable[Path] = (), site: Path | None = None) -> dict[str, str]:
    """Files of `modules`, data folders and version in a fresh interpreter that sees the given folders alone.

    `paths` go to its search path as they are, `site` as a folder of installed packages.
    """
    code = """
import importlib, json, site, sys
options = json.loads(sys.argv[1])
sys.path += options["paths"]
if options["site"]:
    site.addsitedir(options["site"])
found = {name: importlib.import_module(name).__file__ for name in options["modules"]}
from grasp_refine import __version__
from grasp_refine.assets.embedded import resource_dir
found |= {name: str(resource_dir(name)) for name in ("robots", "assets_manifest")}
print(json.dumps(found | {"version": __version__}))
"""
    options = {"modules": modules, "paths": list(map(str, paths)), "site": str(site) if site else None}
    result = subprocess.run(
        [sys.executable, "-I", "-S", "-c", code, json.dumps(options)], cwd="/", capture_output=True, text=True
    )
    assert result.returncode == 0, result.stderr
    return json.loads(result.stdout)


MODULES = {"grasp_refine": "grasp_refine", "grasp_refine_apps.viewer": "apps/grasp_refine_apps/viewer"}
"""Packages that every kind of install can import without any other, and their folders in the repository."""


def in_checkout(source: Path) -> dict[str, str]:
    """Answer of `imported` where both packages are those of a checkout."""
    modules = {name: str(source / folder / "__init__.py") for name, folder in MODULES.items()}
    return modules | {name: str(source / name) for name in ("robots", "assets_manifest")}


def test_a_checkout_is_imported_by_the_paths_of_pytest():
    options = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["pytest"]["ini_options"]
    paths = [(ROOT / path).resolve() for path in options["pythonpath"]]
    assert imported(*MODULES, paths=paths) == in_checkout(ROOT) | {"version": source_version(ROOT)}


def test_an_installed_wheel_finds_its_folders(wheel: Path, version: str, tmp_path: Path):
    site = tmp_path / "site"
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(site)
    assert imported(*MODULES, site=site) == {
        "version": version,
        **{name: str(site / name.replace(".", "/") / "__init__.py") for name in MODULES},
        **{name: str(site / "grasp_refine" / name) for name in ("robots", "assets_manifest")},
    }


def test_an_editable_install_sees_the_checkout(checkout: Path, editable: Path, version: str, tmp_path: Path):
    """Its files and its commit as they are now, not as they were when it was installed."""
    site = tmp_path / "site"
    with zipfile.ZipFile(editable) as archive:
        archive.extractall(site)
    later = {
        "grasp_refine.added_later": checkout / "grasp_refine/added_later.py",
        "grasp_refine.core.added_later": checkout / "grasp_refine/core/added_later.py",
        "grasp_refine_apps.added_later.module": checkout / "apps/grasp_refine_apps/added_later/module.py",
    }
    for path in later.values():
        path.parent.mkdir(exist_ok=True)
        path.write_text("")
        (path.parent / "__init__.py").touch()
    assert version in editable.name
    commit_all(checkout)
    assert source_version(checkout) != version
    assert imported(*MODULES, *later, site=site) == in_checkout(checkout) | {
        "version": source_version(checkout),
        **{name: str(path) for name, path in later.items()},
    }


def test_an_editable_install_gives_type_checkers_two_folders(checkout: Path, editable: Path):
    """They read paths from the .pth file, and run no import hook. The parent of the checkout was among them."""
    with zipfile.ZipFile(editable) as archive:
        (listed,) = (archive.read(name).decode() for name in archive.namelist() if name.endswith(".pth"))
        copied = [name for name in contents(editable) if "/" in name]
    assert [line for line in listed.splitlines() if not line.startswith("import ")] == [
        str(checkout),
        str(checkout / "apps"),
    ]
    assert copied == [], "a copy of data would go stale"


@pytest.mark.slow
def test_with_a_compiler_the_wheel_holds_an_engine_that_works(source: Path, tmp_path: Path):
    for needed in ("nanobind", "cmeel"):
        pytest.importorskip(needed, reason="needed to build the engine")
    if shutil.which(os.environ.get("CXX", "c++")) is None:
        pytest.skip("the engine cannot be built here: no C++ compiler")
    wheel = build(source, "build_wheel", tmp_path / "wheel", compiler=None)
    # Where it does not compile, it is left out.
    assert not wheel.name.endswith("-py3-none-any.whl")
    (compiled,) = contents(wheel) - wanted(source)
    assert compiled.startswith("grasp_refine/collision/_native.")
    site = tmp_path / "site"
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(site)
    code = f"""
import sys
# An editable install would come first.
sys.meta_path = [finder for finder in sys.meta_path if not type(finder).__module__.startswith("_editable")]
sys.path.insert(0, {str(site)!r})
from grasp_refine.collision.engine import engines
found = engines()
import grasp_refine.collision._native as native
print(*found, native.__file__.startswith({str(site)!r}))
"""
    environment = {name: value for name, value in os.environ.items() if name != "LD_LIBRARY_PATH"}
    result = subprocess.run([sys.executable, "-c", code], env=environment, cwd=site, capture_output=True, text=True)
    assert result.stdout.split() == ["native", "python", "True"], result.stderr


IMPORT_CPU_S = 0.05
"""CPU time that importing the library may take."""


def test_importing_the_library_is_instant_and_loads_no_other_package():
    code = """
import sys, time
before, start = set(sys.modules), time.process_time()
import grasp_refine
spent = time.process_time() - start
packages = {name.partition(".")[0] for name in set(sys.modules) - before}
print(spent, *sorted(packages - sys.stdlib_module_names))
"""
    spent = []
    for _ in range(5):
        result = subprocess.run(
            [sys.executable, "-c", code], env=subprocess_environment(), capture_output=True, text=True, check=True
        )
        seconds, *packages = result.stdout.split()
        assert packages == ["grasp_refine"]
        spent.append(float(seconds))
    # Other processes only add to it: caches are cold, the clock of the processor changes.
    assert min(spent) < IMPORT_CPU_S


def test_an_unknown_attribute_of_the_package_is_an_error():
    import grasp_refine

    with refused(AttributeError, "grasp_refine", "nonsense"):
        grasp_refine.nonsense  # noqa: B018
