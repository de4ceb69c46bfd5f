"""Version of a source tree: the release, and the commit where one is known."""

from pathlib import Path

import pytest

from git_repository import commit_all
from grasp_refine.core.source_version import RELEASE, source_version


def test_a_repository_adds_its_commit_and_says_that_files_differ(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("one")
    commit_all(tmp_path)
    first = source_version(tmp_path)
    (tmp_path / "untracked").write_text("")
    assert first.startswith(f"{RELEASE}+g") and source_version(tmp_path) == first
    (tmp_path / "file").write_text("two")
    assert source_version(tmp_path) == f"{first}.dirty"
    commit_all(tmp_path)
    second = source_version(tmp_path)
    assert second != first and "dirty" not in second


def test_a_repository_around_the_sources_is_another_project(tmp_path: Path) -> None:
    inner = tmp_path / "vendored"
    inner.mkdir()
    (inner / "file").write_text("")
    commit_all(tmp_path)
    assert source_version(inner) == RELEASE


def test_an_sdist_keeps_its_version_in_any_repository(tmp_path: Path) -> None:
    (tmp_path / "PKG-INFO").write_text("Metadata-Version: 2.2\nName: grasp-refine\nVersion: 0.2.0+gabcdef1\n")
    commit_all(tmp_path)
    assert source_version(tmp_path) == "0.2.0+gabcdef1"


@pytest.mark.parametrize("fault", ["without git", "damaged"])
def test_an_unreadable_repository_leaves_the_release(
    fault: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").write_text("")
    if fault == "without git":
        commit_all(tmp_path)
        monkeypatch.setenv("PATH", str(tmp_path))
    else:
        (tmp_path / ".git").mkdir()
    assert source_version(tmp_path) == RELEASE


def test_variables_of_a_hook_name_no_other_repository(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("mine", "other"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "file").write_text(name)
        commit_all(tmp_path / name)
    expected = source_version(tmp_path / "mine")
    monkeypatch.setenv("GIT_DIR", str(tmp_path / "other" / ".git"))
    assert source_version(tmp_path / "mine") == expected
