"""CITATION.cff says what this version is, in the form that readers of such files expect."""

from __future__ import annotations

import tomllib
from typing import Any

import pytest
import yaml

from grasp_refine.core.source_version import RELEASE
from readme import ROOT

CITATION = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]

REQUIRED = ("authors", "cff-version", "message", "title")
"""What version 1.2.0 of the format requires of a file; of a reference authors, title and type."""


def test_it_has_what_the_format_requires() -> None:
    assert set(REQUIRED) <= set(CITATION) and CITATION["cff-version"] == "1.2.0"
    assert CITATION["type"] == "software"
    for reference in CITATION["references"]:
        assert {"authors", "title", "type"} <= set(reference)


@pytest.mark.parametrize("cited", [CITATION, *CITATION["references"]], ids=lambda cited: cited["title"])
def test_authors_are_persons_or_groups(cited: dict[str, Any]) -> None:
    assert cited["authors"]
    for author in cited["authors"]:
        assert set(author) in ({"name"}, {"family-names", "given-names"})


def test_it_cites_this_version() -> None:
    assert CITATION["title"] == PROJECT["name"]
    # YAML would read 0.10 as a number.
    assert isinstance(CITATION["version"], str) and CITATION["version"] == RELEASE
    assert CITATION["license"] == PROJECT["license"]
    assert CITATION["keywords"] == PROJECT["keywords"]
