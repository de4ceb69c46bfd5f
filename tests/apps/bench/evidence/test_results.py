"""Results of the evidence: numbers of groups, which failures are shown, and what a changed setting does to trials."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from batch_rows import made_up_rows, shard
from grasp_refine.objects.source import ObjectSource
from grasp_refine.problem.spec import ProblemSpec
from grasp_refine.scene.protocols.registry import PROTOCOLS
from grasp_refine_apps.batch.plan import ShardTask
from grasp_refine_apps.batch.shard import Shard
from grasp_refine_apps.bench.evidence.cases import EvidenceCase, HandCase, ObjectCase
from grasp_refine_apps.bench.evidence.report import PICTURES_PER_REASON, failures, markdown, tables
from grasp_refine_apps.bench.evidence.results import NOT_SIMULATED, Block, agreement, summaries, summary
from grasp_refine_apps.bench.evidence.trials import GEOMETRY, GIVEN, METHODS, REFINED, Trial, trials_shards

NAMES = ("strict",)


def block(number: int, reasons: list[list[str]], hand: str = "leap", thing: str = "mug", **columns: object) -> Block:
    """Grasps with a reason for each of `METHODS`, and columns of the index after the full refinement."""
    case = EvidenceCase(
        f"sampled/{hand}/{thing}",
        "sampled",
        HandCase(hand, hand, hand),
        ObjectCase(thing, f"{thing}.obj", 1.0, 0.1, 0.95 if thing == "ball" else 0.2),
        len(reasons[0]),
        "grasps.npz",
        1.0,
    )
    count = len(reasons[0])
    rows = {GEOMETRY: made_up_rows(count, number, seed=1), REFINED: made_up_rows(count, number, **columns)}
    found = {"strict": dict(zip(METHODS, map(np.array, reasons), strict=True))}
    return Block(case, shard(number, Path(f"{number}.npz"), count), rows, found, 0.5)


@pytest.fixture
def blocks() -> list[Block]:
    held = ["held", "held"]
    return [
        block(0, [["moved", "held"], held, held], penetration_m_before=[0.001, 0.003], moved_palm_m=[0.0, 0.1]),
        block(1, [["moved"], ["rotated"], ["rotated"]], thing="ball", penetration_m_before=0.005, moved_palm_m=0.02),
    ]


def test_shares_are_of_all_grasps_and_reasons_are_the_rest(blocks: list[Block]):
    row = summary("all", blocks, NAMES)
    assert row["grasps"] == 3
    assert row["held_strict"] == pytest.approx([1 / 3, 2 / 3, 2 / 3])
    assert row["reasons_strict"] == [{"moved": 2}, {"rotated": 1}, {"rotated": 1}]


def test_measures_are_means_but_movements_medians_and_there_is_none_as_given(blocks: list[Block]):
    row = summary("all", blocks, NAMES)
    assert row["penetration_m"][0] == pytest.approx(0.003)
    assert row["moved_palm_m"] == [
        None,
        pytest.approx(np.median(np.concatenate([one.rows[GEOMETRY]["moved_palm_m"] for one in blocks]))),
        pytest.approx(0.02),
    ]
    expected = np.concatenate([one.rows[REFINED]["cpu_s"] for one in blocks]).mean()
    assert row["cpu_s"][0] is None
    assert row["cpu_s"][2] == pytest.approx(expected)


def test_grasps_that_could_not_be_refined_have_no_measure(blocks: list[Block]):
    lost = block(2, [["not finite"]] * 3, penetration_m_after=np.nan, moved_palm_m=np.nan)
    assert summary("all", [lost], NAMES)["moved_palm_m"][2] is None
    both = summary("all", [blocks[0], lost], NAMES)
    assert both["moved_palm_m"][2] == pytest.approx(0.05)
    assert both["held_strict"][2] == pytest.approx(2 / 3)


def test_groups_are_in_the_order_given_and_then_by_name(blocks: list[Block]):
    more = [*blocks, block(3, [["held"]] * 3, hand="allegro")]
    by_hand = summaries(lambda case: case.hand.name, more, NAMES)
    assert [(row["label"], row["grasps"]) for row in by_hand] == [("allegro", 1), ("leap", 3)]
    by_shape = summaries(lambda case: case.object.shape, more, NAMES, first=("convex", "concave"))
    assert [(row["label"], row["grasps"]) for row in by_shape] == [("convex", 1), ("concave", 3)]


def test_tables_count_each_grasp_once_and_show_three_values(blocks: list[Block]):
    failed = [{"job": "sampled/leap/spoon", "missing": 2, "reason": "no mesh"}]
    found = {table.title: table for table in tables(blocks, failed, NAMES)}
    reasons = {row["label"]: row["strict"] for row in found["Why grasps do not hold"].rows}
    assert reasons == {"held": [1, 2, 2], "moved": [2, 0, 0], "rotated": [0, 1, 1]}
    text = markdown(list(found.values()), ["with this command"])
    assert "33.3 → 66.7 → 66.7 %" in text
    assert "| moved | 2 → 0 → 0 |" in text
    assert "| sampled/leap/spoon | 2 | no mesh |" in text
    assert "with this command" in text
    assert "By object" not in text, "too long for the documentation"


def test_failures_of_refined_grasps_are_shown_by_reason_of_different_hands_and_objects():
    same = [["held"] * 6, ["held"] * 6, ["moved"] * 6]
    many = [
        block(0, same),
        block(1, [["moved"], ["moved"], ["held"]]),
        block(2, [["held"], ["held"], ["moved"]], "leap", "ball"),
    ]
    many.append(block(3, [["held"], ["held"], ["rotated"]], hand="allegro"))
    many.append(block(4, [[NOT_SIMULATED]] * 3))
    found = failures(many, NAMES)
    assert list(found) == ["moved, strict (7 grasps)", "rotated, strict (1 grasps)"]
    moved = found["moved, strict (7 grasps)"]
    assert len(moved) == PICTURES_PER_REASON
    assert ("leap", "ball") in [(case.hand, case.object) for case in moved], "not six of the first block"
    (rotated,) = found["rotated, strict (1 grasps)"]
    assert (rotated.shard, rotated.hand, rotated.reason, rotated.held) == (3, "allegro", "rotated", False)


def test_trials_are_of_grasps_refined_in_both_ways_and_depend_on_all_settings():
    out = Path("/evidence")

    task = ShardTask(
        "", "job", ProblemSpec(), {}, ("", ""), "", "", ObjectSource("mug"), (1.0,), np.zeros(1), np.zeros(1)
    )

    def of(method: str, number: int, stamp: str) -> Shard:
        path = out / method.replace(" ", "-") / f"job/{number}.npz"
        return replace(shard(number, path), stamp=stamp, task=task)

    refined = {GEOMETRY: [of(GEOMETRY, 0, "a")], REFINED: [of(REFINED, 0, "b"), of(REFINED, 1, "c")]}
    trial = Trial(PROTOCOLS["strict"])
    (found,) = trials_shards(refined, [trial], out)
    assert found.path == out / "trials/mujoco/strict/job/0.npz"
    assert [shard.number for shard in trials_shards(refined, [trial, Trial(PROTOCOLS["tabletop"])], out)] == [0, 1]
    others = [
        trials_shards({**refined, GEOMETRY: [of(GEOMETRY, 0, "other")]}, [trial], out),
        trials_shards({**refined, REFINED: [of(REFINED, 0, "other")]}, [trial], out),
        trials_shards(refined, [Trial(replace(PROTOCOLS["strict"], mass=0.2))], out),
        trials_shards(refined, [replace(trial, engine="drake")], out),
    ]
    assert len({found.stamp, *(one.stamp for (one,) in others)}) == 5
    assert GIVEN == METHODS[0]


def test_engines_agree_on_grasps_tried_in_both(blocks: list[Block]):
    """One grasp of three holds in MuJoCo only as given, and the one of a failed trial does not count."""
    in_drake = [
        {GIVEN: ["moved", "moved"], GEOMETRY: ["held", "held"], REFINED: ["held", "held"]},
        {GIVEN: ["moved"], GEOMETRY: ["held"], REFINED: ["ejected while closing"]},
    ]
    tried = [
        replace(one, reasons={**one.reasons, "strict in Drake": {name: np.array(each) for name, each in found.items()}})
        for one, found in zip(blocks, in_drake, strict=True)
    ]
    lost = block(2, [["held"]] * 3)
    nothing = dict.fromkeys(METHODS, np.array([NOT_SIMULATED]))
    tried.append(replace(lost, reasons={**lost.reasons, "strict in Drake": nothing}))
    labels = Trial(PROTOCOLS["strict"]).label, Trial(PROTOCOLS["strict"], "drake").label
    assert labels == ("strict", "strict in Drake")
    row = agreement("strict", tried, labels)
    assert row["grasps"] == 3
    assert row["share"] == pytest.approx([2 / 3, 2 / 3, 1.0])
    assert row["mujoco_only"] == [1, 0, 0]
    assert row["drake_only"] == [0, 1, 0]
    assert row["kappa"] == pytest.approx([0.0, 0.0, 1.0])
    text = markdown(tables(tried, [], labels, {"strict": labels}), [])
    assert "| strict | 3 | 66.7 → 66.7 → 100.0 % | 0.00 → 0.00 → 1.00 | 1 → 0 → 0 | 0 → 1 → 0 |" in text
    assert "held, strict in Drake" in text
    assert "Agreement" not in markdown(tables(tried, [], labels), [])
