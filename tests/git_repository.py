"""Repositories of git that tests make."""

import shutil
import subprocess
from pathlib import Path

import pytest

AUTHOR = ("-c", "user.name=Nobody", "-c", "user.email=nobody@example.org", "-c", "commit.gpgsign=false")


def commit_all(folder: Path) -> None:
    """Commit all files of a folder, which becomes a repository; skips where git is not installed."""
    if shutil.which("git") is None:
        pytest.skip("git is not installed")
    for words in (("init", "--quiet"), ("add", "--all"), (*AUTHOR, "commit", "--quiet", "--message=Files")):
        subprocess.run(["git", *words], cwd=folder, check=True)
