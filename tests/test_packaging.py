"""The wheel, the wheel built from the sdist, and an editable install hold robots, manifests and apps.

All but one are built where no C++ compiler works, which leaves the compiled engine out.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

import pytest

from refusals import refused

pytest.importorskip("scikit_build_core", reason="the build backend comes with the extra 'test'")

ROOT = Path(__file__).resolve().parents[1]
FOLDERS = ("grasp_refine", "robots", "assets_manifest", "apps")


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
    """Where each source file belongs in the wheel."""
    return {
        str((Path() if folder == "grasp_refine" else Path("grasp_refine")) / path.relative_to(source))
        for folder in FOLDERS
        for path in (source / folder).rglob("*")
        if path.is_file() and "__pycache__" not in path.parts and source / SOURCES not in path.parents
    }


def contents(wheel: Path) -> set[str]:
    with zipfile.ZipFile(wheel) as archive:
        return {name for name in archive.namelist() if ".dist-info/" not in name}


@pytest.fixture
def source(tmp_path: Path) -> Path:
    """A copy of the sources: building in the checkout would leave files there."""
    copy = tmp_path / "source"
    copy.mkdir()
    for name in ("pyproject.toml", "README.md", "CONTRIBUTING.md", "CITATION.cff", "LICENSE", ".gitignore"):
        shutil.copy(ROOT / name, copy)
    for folder in FOLDERS:
        shutil.copytree(ROOT / folder, copy / folder, ignore=shutil.ignore_patterns("__pycache__"))
    return copy


def test_the_wheel_holds_everything_under_the_package(source: Path, tmp_path: Path):
    wheel = build(source, "build_wheel", tmp_path / "wheel")
    assert wheel.name == "grasp_refine-0.1.0-py3-none-any.whl"
    assert contents(wheel) == wanted(source)
    assert {"grasp_refine/apps/__init__.py", "grasp_refine/py.typed"} <= contents(wheel)
    for kind in ("hands", "objects", "grasps"):
        assert f"grasp_refine/assets_manifest/{kind}.toml" in contents(wheel)
    assert any(name.startswith("grasp_refine/robots/allegro/") for name in contents(wheel))


def test_the_wheel_names_its_command_and_licence(source: Path, tmp_path: Path):
    with zipfile.ZipFile(build(source, "build_wheel", tmp_path / "wheel")) as archive:
        info = {Path(name).name: name for name in archive.namelist() if ".dist-info/" in name}
        commands = archive.read(info["entry_points.txt"]).decode().replace(" ", "")
        assert "refine-grasp=grasp_refine_apps.cli:main" in commands
        metadata = archive.read(info["METADATA"]).decode()
        assert "License-Expression: Apache-2.0" in metadata
        assert "Requires-Python: >=3.11" in metadata
        assert b"Apache License" in archive.read(info["LICENSE"])


def test_the_sdist_builds_the_same_wheel(source: Path, tmp_path: Path):
    sdist = build(source, "build_sdist", tmp_path / "sdist")
    with tarfile.open(sdist) as archive:
        archive.extractall(tmp_path / "unpacked", filter="data")
    (unpacked,) = (tmp_path / "unpacked").iterdir()
    assert {path.name for path in (unpacked / SOURCES).iterdir()} >= {"CMakeLists.txt", "module.cpp", "search.h"}
    assert {path.name for path in unpacked.iterdir()} >= {"README.md", "CONTRIBUTING.md", "CITATION.cff", "LICENSE"}
    assert contents(build(unpacked, "build_wheel", tmp_path / "wheel")) == wanted(source)


OFFLINE = ("No matching distribution found", "Temporary failure in name resolution", "Connection")
"""What pip says where it can fetch nothing."""


@pytest.mark.slow
def test_the_sdist_installs_in_an_empty_environment(source: Path, tmp_path: Path):
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
    assert call(program, "--version").stdout == "refine-grasp 0.1.0\n"
    run = call(program, "run", "--geometry-only")
    assert run.returncode == 0, run.stderr
    assert "4 of 4" in run.stdout
    assert (home / "grasp-refine-results/allegro_mug.npz").is_file()
    assert call(program, "doctor").returncode == 0
    listed = call(program, "hands")
    assert listed.returncode == 0 and "shadow_palm" in listed.stdout


def installed(site: Path, *, editable: bool = False) -> dict[str, str]:
    """What a fresh interpreter with nothing but `site` on its path sees."""
    code = """
import json, site, sys
site.addsitedir(sys.argv[1])
import grasp_refine, grasp_refine.apps
from grasp_refine.assets import resource_dir
found = {name: str(resource_dir(name)) for name in ("robots", "assets_manifest", "apps")}
found["version"] = grasp_refine.__version__
found["package"] = grasp_refine.__file__
found["module"] = grasp_refine_apps.__file__
if len(sys.argv) > 2:
    from grasp_refine import added_later
    found["added"] = added_later.__file__
print(json.dumps(found))
"""
    arguments = [sys.executable, "-I", "-S", "-c", code, str(site), *(["added"] if editable else [])]
    result = subprocess.run(arguments, cwd=site, capture_output=True, text=True)
    assert result.returncode == 0, result.stderr
    return json.loads(result.stdout)


def test_an_installed_wheel_finds_its_folders(source: Path, tmp_path: Path):
    site = tmp_path / "site"
    with zipfile.ZipFile(build(source, "build_wheel", tmp_path / "wheel")) as archive:
        archive.extractall(site)
    package = site / "grasp_refine"
    assert installed(site) == {
        "version": "0.1.0",
        "package": str(package / "__init__.py"),
        "module": str(package / "apps" / "__init__.py"),
        **{name: str(package / name) for name in FOLDERS[1:]},
    }


def test_an_editable_install_sees_the_checkout(source: Path, tmp_path: Path):
    site = tmp_path / "site"
    with zipfile.ZipFile(build(source, "build_editable", tmp_path / "wheel")) as archive:
        archive.extractall(site)
    later = source / "grasp_refine" / "added_later.py"
    later.write_text("")
    assert installed(site, editable=True) == {
        "version": "0.1.0",
        "package": str(source / "grasp_refine" / "__init__.py"),
        "module": str(source / "apps" / "__init__.py"),
        "added": str(later),
        **{name: str(source / name) for name in FOLDERS[1:]},
    }


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


def test_importing_the_package_loads_nothing_else():
    code = """
import sys
before = set(sys.modules)
import grasp_refine
print(sorted(set(sys.modules) - before))
"""
    result = subprocess.run(
        [sys.executable, "-I", "-S", "-c", f"import sys; sys.path.insert(0, {str(ROOT)!r}){code}"],
        capture_output=True,
        text=True,
        check=True,
    )
    assert result.stdout.strip() == "['grasp_refine']"


def test_an_unknown_attribute_of_the_package_is_an_error():
    import grasp_refine

    with refused(AttributeError, "grasp_refine", "nonsense"):
        grasp_refine.nonsense  # noqa: B018
