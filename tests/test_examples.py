"""The scripts in the folder `examples` run, and do what they say."""

from __future__ import annotations

import re
import runpy
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import grasp_refine as gr
from grasp_refine.grasps.formats.listing import FORMATS
from readme import ROOT

EXAMPLES = sorted((ROOT / "examples").glob("*.py"))

pytestmark = pytest.mark.slow


@pytest.fixture(autouse=True)
def without_additions(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """In a folder of its own; a format that an example adds is removed."""
    monkeypatch.chdir(tmp_path)
    yield
    if "my_lab" in {known.name for known in FORMATS}:
        FORMATS.remove("my_lab")


def run(number: int) -> dict[str, Any]:
    """Names that an example leaves behind."""
    return runpy.run_path(str(EXAMPLES[number - 1]))


def test_there_are_eight_and_the_list_names_them():
    listed = re.findall(r"\]\((\w+\.py)\)", (ROOT / "examples" / "README.md").read_text(encoding="utf-8"))
    assert listed == [path.name for path in EXAMPLES] and len(listed) == 8


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_examples_need_the_facade_alone(path: Path):
    text = path.read_text(encoding="utf-8")
    assert "import grasp_refine as gr" in text and not re.search(r"grasp_refine(_apps)?\.\w", text)
    assert set(re.findall(r"\bgr\.(\w+)", text)) <= set(dir(gr))


def test_a_file_is_refined(capsys: pytest.CaptureFixture[str]):
    names = run(1)
    held = names["trials"].held
    assert len(gr.load_grasps("refined.npz")) == 4 and held[:, 1].sum() >= 3
    assert f"{held[:, 1].sum()} after" in capsys.readouterr().out


def test_an_own_hand_is_read_and_refined():
    names = run(2)
    assert [contact.link for contact in names["hand"].contacts] == ["left", "right"]
    assert (names["refined"].quality[:, 1] > 0.9).all()


def test_an_own_loss_moves_the_contacts():
    names = run(3)
    away = [
        np.abs(found.outcome.contact_point_object[..., 2][found.outcome.touching] - names["HEIGHT"]).mean()
        for found in (names["plain"], names["refined"])
    ]
    assert away[1] < 0.7 * away[0]


def test_an_own_term_is_right_and_minimised():
    names = run(4)
    assert all(found.max() < 1e-6 for found in names["errors"].values())
    plain, refined = (np.abs(names[name].after.q[:, 0]) for name in ("plain", "refined"))
    assert refined.mean() < 0.1 * plain.mean()


def test_an_own_solver_lowers_the_loss():
    refined = run(5)["refined"]
    before, after = (np.nan_to_num(refined.outcome["penetration_m"]) + refined.outcome["contact_error_m"]).T
    assert (after < 0.5 * before).all()


def test_an_own_format_is_read():
    names = run(6)
    np.testing.assert_allclose(names["grasps"].q, names["drawn"].q, atol=1e-12)
    assert (names["refined"].quality[:, 1] > 0.9).all()


def test_a_batch_goes_on_and_lists_what_failed():
    names = run(7)
    assert [*names["failed"]] == ["missing"] and len(names["rows"]) == 6
    assert (
        len(Path("refined/index.csv").read_text().splitlines()) == 7 and len(list(Path("refined").glob("*.npz"))) == 3
    )


def test_an_arm_lifts_what_it_reaches():
    names = run(8)
    assert names["reached"].sum() >= 2 and names["trials"].held[names["reached"], 1].all()
