"""`--html` of `run` and `validate`: a card for each grasp; commands work from the folder of the page."""

from __future__ import annotations

import re
import shlex
from html import unescape
from pathlib import Path

import pytest

from grasp_refine.assets.embedded import resource_dir
from grasp_refine_apps.cli import main
from grasp_refine_apps.commands.options import parse
from grasp_refine_apps.commands.view import View
from grasp_refine_apps.grasp_page import sheet

EXAMPLE = str(resource_dir("robots") / "allegro" / "example_rounded_box.npz")
OTHER = ("--from", "allegro", "--hand", "leap")


def cards(path: str) -> list[str]:
    """Cards of a page."""
    return re.findall("<figure>.*?</figure>", Path(path).read_text(), re.S)


def commands(path: str) -> list[list[str]]:
    """Commands on the cards of a page."""
    found = re.findall('<code class="command">(.*?)</code>', Path(path).read_text())
    return [shlex.split(unescape(text)) for text in found]


@pytest.mark.usefixtures("one_side")
def test_pages_of_a_refinement_and_of_validations(workplace: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    Path("pages").mkdir()
    grasps = ("--index", "1", "3")
    assert main(["run", "--grasps", EXAMPLE, *grasps, "--starts", "1", "--out", "out", "--html", "pages/run.html"]) == 0
    (result,) = Path("out").glob("*.npz")
    found = cards("pages/run.html")
    assert [card.count("<img") for card in found] == [2, 2] and all("quality" in card and "→" in card for card in found)
    for row, (program, name, file, *options) in enumerate(commands("pages/run.html")):
        assert (program, name) == ("refine-grasp", "view") and (Path("pages") / file).resolve() == result.resolve()
        view = parse(View, "view", [file, *options])
        assert view.inputs.index == (row,), "the result has two rows, the input four"

    assert main(["validate", EXAMPLE, *grasps, "--no-simulate", "--html", "one.html"]) == 0
    assert [card.count("<img") for card in cards("one.html")] == [1, 1]
    assert [command[-1] for command in commands("one.html")] == ["1", "3"]

    monkeypatch.setattr(sheet, "MAX_CARDS", 1)
    both = ("validate", EXAMPLE, str(result), "--no-simulate", "--html", "two.html")
    assert main([*both, "--index", "0", "1"]) == 0
    page = Path("two.html").read_text()
    assert len(cards("two.html")) == 2 and page.count("1 other ") == 2, "the worst of each file"


@pytest.mark.slow
@pytest.mark.usefixtures("one_side")
def test_pages_of_transfers_name_the_hand_that_has_the_grasps(workplace: Path) -> None:
    assert main(["transfer", EXAMPLE, "--index", "3", *OTHER, "--geometry-only", "--html", "other.html"]) == 0
    ((*_, file, row, number, hand, name),) = [command[:7] for command in commands("other.html")]
    assert (row, number, hand, name) == ("--index", "0", "--hand", "leap") and Path(file).is_file()
    assert "--transfer-from" not in Path("other.html").read_text().partition("With <code>")[0], "it is of LEAP now"
