"""The table at the end of a batch: numbers of the statistics, lines that fit, failures by name."""

from __future__ import annotations

import io

import pytest
from rich.console import Console

from batch_rows import document, made_up_rows
from grasp_refine_apps.batch.statistics import Statistics
from grasp_refine_apps.batch.table import batch_table


def printed(document: dict, statistics: Statistics, width: int = 80) -> list[str]:
    console = Console(file=io.StringIO(), width=width, highlight=False)
    console.print(batch_table(document, statistics))
    return [line.rstrip() for line in console.file.getvalue().splitlines()]


def some(objects: int, **columns: object) -> Statistics:
    found = Statistics.empty()
    for number in range(objects):
        found.add(made_up_rows(10, number, object=f"object-{number:02d}", **columns))
    return found


def test_a_line_for_each_object_and_one_for_all():
    found = Statistics.empty()
    held = {"good_before": [1, 0, 0, 0], "held_before": [1, 1, 0, 0], "reason_after": ["", "", "", "moved"]}
    quality = {"quality_before": 0.25, "quality_after": 0.75, "penetration_m_after": 2e-3}
    found.add(made_up_rows(4, object="mug", good_after=[1, 1, 1, 0], held_after=[1, 1, 1, 0], **held, **quality))
    found.add(made_up_rows(4, 1, object="cup", good_after=[1, 1, 0, 0], held_after=[1, 1, 0, 0], **held, **quality))
    lines = printed(document(config={"protocol": {"name": "strict", "palm": "rigid"}}), found)
    assert lines[0] == "8 grasps, most failures first"
    rows = [line.replace("→", "").split() for line in lines]
    assert ["cup", "4", "50.0", "50.0", "25.0", "50.0", "0.250", "0.750", "2.00"] in rows
    assert ["mug", "4", "50.0", "75.0", "25.0", "75.0", "0.250", "0.750", "2.00"] in rows
    assert ["all", "8", "50.0", "62.5", "25.0", "62.5", "0.250", "0.750", "2.00"] in rows
    at = lines.index("held in simulation (strict): 4 → 5 of 8; gained 1, lost 0")
    assert lines[at - 1] == "" and lines[at + 1] == "  2 moved"
    before, after = " ".join(lines[at + 2 : -1]).split(" after, ")
    assert before.endswith("2 of 8, all of which held; 2 of the 6 others held")
    assert after.endswith("5 of 8, all of which held; 0 of the 3 others held")
    assert lines[-1] == "12.0 grasps/s, at most 512 MiB a process"


@pytest.fixture(scope="module")
def large() -> Statistics:
    """Of many grasps, with long names."""
    found = some(2, hand="shadow_left", quality_after=1.0)
    found.add(made_up_rows(12_345, 7, object="a-long-name-of-an-object-0123456789", penetration_m_after=0.1))
    return found


@pytest.mark.parametrize("width", [80, 100, 120])
def test_no_number_is_cut_and_no_line_too_long(width: int, large: Statistics):
    lines = printed(document(), large, width)
    assert max(map(len, lines)) <= width and not any("…" in line for line in lines)
    # Where there is no room, the name goes on in the next line.
    names = "".join(line.split("  ")[0] for line in lines)
    assert "a-long-name-of-an-object-0123456789" in names
    assert any("12\u202f345" in line and line.endswith("100.00") for line in lines)
