"""The examples of the guide on extensions do what it says."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import grasp_refine as gr
from grasp_refine.grasps.formats.listing import FORMATS
from grasp_refine.measures.measures import MEASURES
from readme import blocks, extension_blocks


@pytest.fixture(autouse=True)
def without_additions(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """In a folder of its own; what an example adds is removed."""
    monkeypatch.chdir(tmp_path)
    known = {id(registry): {registry.name_of(entry) for entry in registry} for registry in (FORMATS, MEASURES)}
    yield
    for registry in (FORMATS, MEASURES):
        for name in {registry.name_of(entry) for entry in registry} - known[id(registry)]:
            registry.remove(name)


def run(mark: str) -> dict[str, Any]:
    """Names that the example with a mark leaves behind."""
    (block,) = (block for block in extension_blocks() if mark in block)
    names: dict[str, Any] = {"__name__": "extend"}
    exec(compile(block, mark, "exec", dont_inherit=True), names)
    return names


def test_groups_of_entry_points_are_those_of_the_registries():
    (block,) = (block for block in blocks("toml") if "entry-points" in block)
    groups = tomllib.loads(block)["project"]["entry-points"]
    assert set(groups) == {FORMATS.group, MEASURES.group}


def test_there_are_four():
    assert len(extension_blocks()) == 4


def test_the_term_is_minimised():
    names = run("PalmHeight")
    away = [np.abs(grasps.hand_pose[:, 2] - 0.15) for grasps in (names["refined"].before, names["refined"].after)]
    assert away[1].max() < 0.1 * away[0].max()


def test_the_solver_refines():
    refined = run("GaussNewton")["refined"]
    gaps = refined.outcome["contact_error_m"].T
    assert np.median(gaps[1]) < 0.2 * np.median(gaps[0])


def test_the_format_is_found():
    grasps = run("MyLab")["grasps"]
    assert grasps.joint_names == ("a",) and grasps.q.tolist() == [[0.1]] and "my_lab" in {one.name for one in FORMATS}


def test_the_measure_stands_beside_ours():
    names = run("palm_height")
    expected = names["evaluated"].problem.groups[0].grasps.hand_pose[:, 2]
    np.testing.assert_allclose(names["evaluated"].validated.metrics.palm_height_m, expected)
    one = names["evaluated"].problem.groups[0].grasps[:1]
    refined = gr.refine(names["hand"], names["mug"], one, gr.Config(starts=1))
    assert {column for column in refined.columns() if column.startswith("palm_height")}
