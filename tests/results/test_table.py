"""Reports on made-up outcomes: what a person reads, and what programs read."""

from __future__ import annotations

import io
import json
import os
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console, RenderableType
from rich.console import Group as RichGroup

from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.json_files import check_writable, dumps, save_json
from grasp_refine.core.versions import Requirement, requirements, versions
from grasp_refine.hands.hand import load_hand
from grasp_refine.objects.object import load_object
from grasp_refine.refinement.losses import Weights
from grasp_refine.refinement.max_move import MaxMove
from grasp_refine.refinement.refine import Config, Scene, refine
from grasp_refine.refinement.solvers.descent import Descent
from grasp_refine.refinement.solvers.levenberg_marquardt import LevenbergMarquardt
from grasp_refine.refinement.solvers.status import Status
from grasp_refine.results.document import run_document, settings
from grasp_refine.results.outcome import Outcome, compare
from grasp_refine.results.result_files import result_paths
from grasp_refine.results.simulated import SimulatedGrasps
from grasp_refine.results.table import grasp_table
from grasp_refine.results.verdict import BAR, HOLDS, Agreement, should_hold, status_advice
from grasp_refine.scene.contact_selection import ContactSelection
from grasp_refine.validation.measures import SIDES
from grasp_refine.validation.metrics import metrics
from grasp_refine.validation.motion import closing_motion
from grasp_refine.validation.protocol import Protocol
from grasp_refine.validation.trials import Reason, Trials
from grasp_refine_apps.report.screen import screen
from made_results import plain_outcome, with_measures
from refusals import assert_names, refused


def made_up(count: int, objects: tuple[str, ...] = ("mug",)) -> Outcome:
    """Grasp i has a contact error of i mm after and 10 i mm before, and converged; all else is the same for all.

    There are no targets, and with so much quality all should hold.
    """
    outcome = plain_outcome(
        count,
        starts=2,
        iterations=123,
        quality=(0.4, 0.97),
        wrench_residual=(0.2, 0.05),
        penetration=(2e-3, 1e-4),
        self_penetration=(1e-3, 0.0),
        moved_palm_m=4e-3,
        moved_palm_rad=np.radians(5.0),
        moved_joints_rad=np.radians(6.0),
        wall_s=0.25,
    )
    error = np.full((count, 2, 3), np.nan)
    error[:, :, 0] = np.arange(count)[:, None] * (1e-2, 1e-3)
    error[:, :, 1] = 0.0
    outcome = replace(outcome, object=np.resize(np.array(objects), count), row=np.arange(count) + 100)
    return with_measures(outcome, contact_error=error)


def with_status(outcome: Outcome, **grasps: Status) -> Outcome:
    """The outcome with the status of grasps changed, such as g3=Status.STALLED."""
    status = outcome.status.copy()
    for name, value in grasps.items():
        status[int(name[1:])] = value
    return replace(outcome, status=status)


def with_quality(outcome: Outcome, **grasps: float) -> Outcome:
    """The outcome with the quality of refined grasps changed, such as g3=0.5."""
    quality = outcome.quality.copy()
    for name, value in grasps.items():
        quality[int(name[1:]), 1] = value
    return with_measures(outcome, quality=quality)


def aimed(outcome: Outcome) -> Outcome:
    """The outcome, as if there had been targets."""
    outcome = replace(outcome, target_link=np.zeros_like(outcome.target_link))
    return with_measures(outcome, starts=np.ones_like(outcome["starts"]))


GEOMETRY = Config(weights=Weights(wrench=0.0))


def text(
    outcome: Outcome,
    config: Config | None = None,
    simulated: SimulatedGrasps | None = None,
    *,
    width: int = 80,
    verbose: bool = False,
) -> list[str]:
    stream = io.StringIO()
    table = grasp_table(outcome, "claw", config or Config(), simulated, verbose=verbose)
    Console(file=stream, width=width, emoji=False).print(table)
    return stream.getvalue().splitlines()


# The table


def test_the_table_speaks_millimetres_and_degrees():
    lines = text(made_up(3))
    assert_names(lines[0], "claw", "mug", "3 grasps")
    (row,) = [line for line in lines if line.split()[:1] == ["2"]]
    assert " ".join(row.split()) == "2 20.00 → 2.00 2.00 → 0.10 4.0 5.0 6.0 0.400 → 0.970 should hold"
    (median,) = [line for line in lines if line.startswith("median")]
    assert " ".join(median.split()) == "median 10.00 → 1.00 2.00 → 0.10 4.0 5.0 6.0 0.400 → 0.970"
    for line, named in zip(
        lines[-7:],
        (
            (f"quality {BAR}", "0 → 3 of 3", "--validate"),
            ("3 of 3", "converged"),
            ("wrench residual", "3 of 3", "mean 0.200 → 0.050"),
            ("contact error", "2 of 2", "mean 10.000 → 1.000 mm"),
            ("penetration", "3 of 3", "mean 2.000 → 0.100 mm"),
            ("self-penetration", "3 of 3", "mean 1.000 → 0.000 mm"),
            ("2 / 2 starts", "123 / 123 iterations", "0.25 s / 0.25 s"),
        ),
        strict=True,
    ):
        assert_names(line, *named)


def test_a_measure_that_fell_nowhere_is_not_called_less():
    outcome = made_up(3)
    worse = with_measures(outcome, penetration=outcome["penetration"][:, ::-1].copy())

    def told(outcome: Outcome) -> str:
        (line,) = [line for line in text(outcome) if line.startswith("penetration") and "mean" in line]
        return line

    way, back = (told(one).partition("3 of 3")[0] for one in (outcome, worse))
    assert way != back and "3 of 3" in told(outcome) and "3 of 3" in told(worse)
    mixed = with_measures(outcome, penetration=np.array([[2e-3, 1e-3], [1e-3, 2e-3], [1e-3, 1e-3]]))
    assert re.search(r"\b1\b.* 1 of 3\b", told(mixed))


def test_what_the_verdict_is_depends_on_what_was_wanted():
    """Where grasps should hold it is by quality; elsewhere it is how the refinement ended, and quality is told."""
    outcome = with_status(with_quality(made_up(3), g1=0.9), g1=Status.STALLED, g2=Status.STALLED)
    last = {
        name: [" ".join(line.split()[-2:]) for line in lines if "→" in line and line.split()[0] in "012"]
        for name, lines in (
            ("holds", text(outcome)),
            ("geometry", text(outcome, GEOMETRY)),
            ("targets", text(aimed(outcome))),
        )
    }
    assert last["holds"] == ["should hold", "may slip", "should hold"]
    assert last["geometry"] == last["targets"] == ["0.970 converged", "0.900 stalled", "0.970 stalled"]
    assert any(line.startswith(f"quality {BAR}") and "0 → 2 of 3" in line for line in text(aimed(outcome)))
    assert_names(text(aimed(outcome))[-1], "123 / 123 iterations", "0.25 s / 0.25 s")
    assert "starts" not in text(aimed(outcome))[-1]


def test_what_can_be_done_about_grasps_that_may_slip():
    def said(config: Config, outcome: Outcome = with_quality(made_up(3), g2=0.9)) -> str:  # noqa: B008
        (line,) = [line for line in text(outcome, config, width=200) if "may slip (2)" in line]
        return line.partition(": ")[2]

    def options(advice: str) -> list[str]:
        return re.findall(r"--[a-z-]+", advice)

    assert options(said(Config())) == ["--starts"]
    bounded = Config(max_move=MaxMove(joints=0.1), seconds=2.0)
    assert options(said(bounded)) == ["--starts", "--max-move", "--seconds"]
    assert said(GEOMETRY) and not options(said(GEOMETRY))
    assert_names(said(Config(solver=Descent())), "--solver levenberg-marquardt", "descent")
    advice = said(Config(), aimed(with_quality(made_up(3), g2=0.9)))
    assert "targets" in advice and not options(advice)


def test_the_iterations_of_a_stage_are_not_the_users():
    """They end a start; raising --iterations would do nothing."""
    outcome = with_status(made_up(2), g1=Status.BUDGET)
    own = status_advice(Status.BUDGET, outcome, Config())
    assert own != Status.BUDGET.advice and "--" not in own
    assert "--seconds" in status_advice(Status.BUDGET, outcome, Config(seconds=1.0))
    bounded = Config(max_move=MaxMove(translation=0.0))
    assert status_advice(Status.STALLED, outcome, bounded).startswith(Status.STALLED.advice)
    assert "--max-move" in status_advice(Status.STALLED, outcome, bounded)
    assert "--max-move" not in Status.STALLED.advice
    for few in (Config(solver=LevenbergMarquardt(iterations=5)), GEOMETRY):
        assert status_advice(Status.BUDGET, outcome, few) == Status.BUDGET.advice


def test_a_quality_that_is_not_known_is_not_good():
    good = should_hold(np.array([np.nan, 0.0, HOLDS, 1.0, HOLDS - 1e-9]))
    assert good.tolist() == [False, False, True, True, False]


def counts(line: str) -> list[int]:
    """The numbers of a line after its title."""
    return [int(number) for number in re.findall(r"\d+", line.rpartition(": ")[2])]


def test_quality_is_told_against_simulation():
    good, held = np.array([True, True, False, False, False]), np.array([True, False, True, True, False])
    agreement = Agreement.of(good, held)
    assert agreement == Agreement(good=2, good_held=1, others=3, others_held=2)
    assert agreement + Agreement.of(good[:2], held[:2]) == Agreement(4, 2, 3, 2)
    assert counts(agreement.line().plain) == [2, 5, 1, 2, 3], "of 5, 2 are good, 1 failed; 2 of 3 others held"
    assert counts(Agreement.of(good[2:], held[2:]).line().plain) == [0, 3, 2, 3]
    # Of one grasp, words say whether it held.
    one_of_one = [Agreement.of(good[:1], np.array([it])).line().plain for it in (True, False)]
    assert [counts(line) for line in one_of_one] == [[1, 1], [1, 1]] and len(set(one_of_one)) == 2
    both = [Agreement.of(good[1:3], np.array([False, it])).line().plain for it in (True, False)]
    assert [counts(line) for line in both] == [[1, 2], [1, 2]] and len(set(both)) == 2


def simulated(*pairs: tuple[bool, bool]) -> SimulatedGrasps:
    """What simulation says of grasps that held or not, before and after."""

    def trials(held: list[bool]) -> Trials:
        reason = np.where(held, Reason.HELD, Reason.MOVED)[:, None]
        one, many = np.zeros((len(held), 1)), np.zeros((len(held), 1, 2), dtype=bool)
        return Trials(
            directions=("+z",), links=("palm", "tip"), reason=reason, time_s=one, displacement_m=one, angle_rad=one,
            peak_m=one, peak_rad=one, contacts=many, closing_m=one[:, 0], closing_rad=one[:, 0],
            penetration_m=one[:, 0], contacts_grasp=many[:, 0], contacts_squeeze=many[:, 0],
        )  # fmt: skip

    before, after = (trials(list(side)) for side in zip(*pairs, strict=True))
    return SimulatedGrasps(Protocol(), before, {"pregrasp": "own", "squeeze": "own"}, after)


def test_where_grasps_were_simulated_this_is_told_first_and_before_as_well_as_after():
    outcome = with_quality(made_up(4), g3=0.5)
    proof = simulated((True, True), (False, True), (True, False), (False, False))
    lines = text(outcome, simulated=proof, width=120)
    rows = [line for line in lines if "→" in line and line.split()[0] in "0123"]
    assert [line.split()[-3:] for line in rows] == [
        ["yes", "→", "yes"], ["no", "→", "yes"], ["yes", "→", "no"], ["no", "→", "no"]
    ]  # fmt: skip
    verdict = lines[lines.index("", 3) + 1 :]
    assert_names(verdict[0], "(force-closure)", "2 → 2 of 4", "gained 1", "lost 1")
    assert verdict[2].startswith("before") and counts(verdict[2]) == [0, 4, 2, 4]
    assert verdict[3].startswith("after") and counts(verdict[3]) == [3, 4, 1]
    assert_names(verdict[4], "1 ", "(3)", "--starts")
    assert max(map(len, text(outcome, simulated=proof))) <= 80


def test_the_worst_of_many_are_those_that_did_not_hold():
    outcome = with_quality(made_up(41), g5=0.5)
    lines = text(outcome, simulated=simulated(*((True, i != 30) for i in range(41))))
    shown = [line.split()[0] for line in lines if "→" in line and line.split()[0].isdigit()]
    assert shown[:2] == ["30", "5"]


@pytest.mark.parametrize("width", [80, 100])
def test_the_table_loses_nothing_at_80_columns(width: int):
    outcome = with_status(made_up(5), g0=Status.NOT_FINITE, g1=Status.NO_TARGET)
    outcome = with_measures(
        outcome, contact_error=outcome.measures["contact_error"] * 40, penetration=outcome["penetration"] * 50
    )
    lines = text(outcome, width=width)
    assert max(map(len, lines)) <= width
    assert not any("…" in line for line in lines)
    assert any("1600.0 → 160.0" in line for line in lines)


def test_each_status_comes_with_its_advice():
    lines = text(with_status(made_up(4), g1=Status.BUDGET, g2=Status.BUDGET, g3=Status.NO_TARGET), width=100)
    assert any("1 of 4" in line and "converged" in line for line in lines)
    assert f"1 no target (3): {Status.NO_TARGET.advice}" in lines
    many = with_status(made_up(20), **{f"g{i}": Status.BUDGET for i in range(13)})
    assert f"13 budget: {Status.BUDGET.advice}" in text(many, GEOMETRY, width=100)


def test_of_many_grasps_the_worst_are_listed():
    outcome = with_status(made_up(41), g7=Status.NO_TARGET)

    def listed(outcome: Outcome, config: Config) -> list[str]:
        words = [line.split() for line in text(outcome, config) if "→" in line]
        return [first for first, *_ in words if first.isdigit()]

    assert listed(outcome, GEOMETRY) == ["7", *(str(i) for i in range(40, 31, -1))]
    # Made to hold, the worst are those that are likeliest to slip.
    outcome = with_quality(outcome, **{f"g{i}": 0.5 + 0.01 * i for i in range(10, 25)})
    assert listed(outcome, Config()) == ["7", *(str(i) for i in range(10, 19))]
    assert_names(text(outcome)[0], "41 grasps", "10", "--verbose")
    for lines, count in ((text(outcome, verbose=True), 41), (text(made_up(40)), 40)):
        assert sum("→" in line and line.split()[0].isdigit() for line in lines) == count


def test_each_object_has_its_table_and_all_have_one():
    lines = text(made_up(5, ("mug", "[bold]can")))
    titles = [line.strip() for line in lines if re.search(r": \d grasps$", line.strip())]
    for title, named in zip(
        titles, (("claw", "mug", "3 grasps"), ("claw", "[bold]can", "2 grasps"), ("2 objects", "5 grasps")), strict=True
    ):
        assert_names(title, *named)
    assert any("5 of 5" in line and "converged" in line for line in lines)


def test_what_there_is_none_of_is_a_dash():
    outcome = with_status(made_up(1), g0=Status.NO_TARGET)
    outcome = with_measures(outcome, contact_error=np.full((1, 2, 3), np.nan), moved_palm_m=np.array([np.nan]))
    (row,) = [line for line in text(outcome) if "no target" in line and "→" in line]
    assert row.split()[:4] == ["0", "-", "→", "-"]


def test_the_screen_is_80_to_100_columns(monkeypatch: pytest.MonkeyPatch):
    for columns, width in (("40", 80), ("90", 90), ("200", 100)):
        monkeypatch.setenv("COLUMNS", columns)
        assert screen().width == width


# The outcome


@pytest.mark.parametrize("wrapped", [lambda text: text, lambda text: RichGroup("b", text)], ids=["alone", "in a group"])
def test_what_is_printed_controls_no_terminal(
    wrapped: Callable[[str], RenderableType], capsys: pytest.CaptureFixture[str]
):
    screen().print(wrapped("a \x1b[31m\x9b2J\u202eé\nb"), markup=False, soft_wrap=True)
    out = capsys.readouterr().out
    assert all(character.isprintable() or character == "\n" for character in out)
    assert "a \\x1b[31m\\x9b2J\\u202eé\nb" in out


def test_worst_and_mean_errors_look_at_links_with_targets():
    outcome = made_up(3)
    entries = outcome.entries()
    np.testing.assert_allclose([entries[f"contact_error_{side}"][2] for side in SIDES], [0.02, 0.002])
    np.testing.assert_allclose([entries[f"contact_error_mean_{side}"][2] for side in SIDES], [0.01, 0.001])
    aimless = with_measures(outcome, contact_error=np.full((3, 2, 3), np.nan)).entries()
    for name in ("contact_error_before", "contact_error_mean_after"):
        assert np.isnan(aimless[name]).all()


def test_join_and_select_keep_grasps_whole():
    first, second = made_up(2), made_up(3, ("can",))
    joined = Outcome.join([first, second]).select(np.array([4, 0]))
    assert joined.object.tolist() == ["can", "mug"]
    assert joined.index.tolist() == [2, 0]
    np.testing.assert_array_equal(joined.measures["contact_error"][0], second.measures["contact_error"][2])


def test_the_outcome_measures_a_refinement():
    """A hand far from its targets: errors, points and movement against what they are by definition."""
    hand, ball = load_hand("allegro", candidates=64), load_object("sphere:0.04", candidates=64)
    T = np.eye(4)
    T[:3, 3] = (-0.09, 0.0, -0.03)
    scene = Scene(hand, ball, T[None], hand.rest[None])
    config = Config(solver=Descent(iterations=40), contact_selection=ContactSelection(reach=0.2), nearest=True)
    refinement = refine(scene, config)
    motion = closing_motion(replace(scene, T_world_root=refinement.T_world_root, q=refinement.q))
    outcome = compare(
        scene, refinement, motion, margin=0.0, name="ball", scale=2.0, row=np.array([5]), index=np.array([1])
    )
    np.testing.assert_allclose(outcome.stage_pose[:, 1], outcome.hand_pose, atol=1e-12)
    np.testing.assert_array_equal(outcome.stage_q[:, 1], refinement.q)
    measured = metrics(hand, ball, refinement.T_world_root, refinement.q)
    np.testing.assert_allclose(outcome["wrench_residual"][:, 1], measured.wrench_residual, rtol=1e-9)
    np.testing.assert_allclose(outcome.quality[:, 1], measured.quality, rtol=1e-6)
    assert outcome["starts"].tolist() == [1] and outcome.aimed.all()
    assert outcome.usable.all()
    assert (outcome.object[0], outcome.scale[0], outcome.row[0], outcome.index[0]) == ("ball", 2.0, 5, 1)
    with_target = ~np.isnan(outcome.target_link[0, :, 0])
    # Witness points on a ball lie on it, along the normal that looks into it.
    on_ball = outcome.contact_object[0, with_target]
    np.testing.assert_allclose(np.linalg.norm(on_ball, axis=1), 0.04)
    np.testing.assert_allclose(outcome.contact_normal[0, with_target], -on_ball / 0.04, atol=1e-9)
    assert np.isnan(outcome.contact_object[0, ~with_target]).all()
    np.testing.assert_allclose(
        outcome["moved_palm_m"][0], np.linalg.norm(refinement.T_world_root[0, :3, 3] - T[:3, 3]), rtol=1e-12
    )
    miss = np.linalg.norm(outcome.contact_link - outcome.target_link, axis=-1)[0, with_target]
    assert (miss <= outcome.measures["contact_error"][0, 1, with_target] + 1e-12).all()
    before, after = outcome["contact_error"][0]
    assert after < before


# JSON


def test_a_document_has_si_units_and_null_for_nan():
    outcome = with_status(made_up(2), g1=Status.NO_TARGET)
    quality = np.array([[0.4, 0.9], [0.97, np.nan]])
    outcome = with_measures(outcome, moved_palm_m=np.array([0.004, np.nan]), quality=quality)
    document = run_document(outcome, Config(seed=3), config={"a": Path("b")}, wall_s=1.5, cpu_s=2.0)
    read = json.loads(dumps(document), parse_constant=lambda name: pytest.fail(f"{name} is no JSON"))
    assert read["config"] == {"a": "b"}
    assert read["totals"] == {
        "n": 2, "converged": 1, "good_before": 1, "good_after": 0, "success_before": None, "success_after": None,
        "wall_s": 1.5, "cpu_s": 2.0,
    }  # fmt: skip
    first, second = read["grasps"]
    assert (first["index"], first["row"], first["status"], first["starts"]) == (0, 100, "converged", 2)
    assert "may slip" in first["advice"] and "--starts" in first["advice"]
    assert second["advice"] == Status.NO_TARGET.advice
    assert first["quality"] == {"before": 0.4, "after": 0.9} and second["quality"] == {"before": 0.97, "after": None}
    assert second["contact_error_m"] == {
        "before": {"max": 0.01, "mean": 0.005}, "after": {"max": 0.001, "mean": 0.0005}
    }  # fmt: skip
    assert second["wrench_residual"] == {"before": 0.2, "after": 0.05}
    assert second["simulation"] == {"before": None, "after": None}
    assert second["penetration_m"] == {"before": 0.002, "after": 0.0001}
    assert second["moved"] == {
        "palm_m": None, "palm_rad": pytest.approx(np.radians(5)), "joints_rad": pytest.approx(np.radians(6))
    }  # fmt: skip


def test_settings_name_the_method_that_was_chosen():
    described = settings(Config())
    assert described["solver"]["type"] == "LevenbergMarquardt"
    assert described["derivative"]["neighborhood"]["type"] == "Adaptive"
    json.loads(dumps(described))


def test_json_appears_whole_or_not_at_all(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    path = tmp_path / "a" / "report.json"
    save_json(path, {"x": 1})
    assert json.loads(path.read_text()) == {"x": 1}

    def fail(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", fail)
    with refused(GraspRefineError, path, "No space left on device"):
        save_json(path, {"x": 2})
    assert json.loads(path.read_text()) == {"x": 1}
    assert list(path.parent.iterdir()) == [path]


def test_json_goes_through_links_and_pipes(tmp_path: Path):
    """Replacing them would, as root, replace /dev/null."""
    target, link, pipe = tmp_path / "target.json", tmp_path / "link.json", tmp_path / "pipe"
    link.symlink_to(target)
    save_json(link, {"x": 1})
    assert link.is_symlink() and json.loads(target.read_text()) == {"x": 1}
    os.mkfifo(pipe)
    reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    save_json(pipe, {"x": 2})
    assert json.loads(os.read(reader, 1000)) == {"x": 2}
    os.close(reader)
    assert pipe.is_fifo()


def test_unwritable_places_are_found_out_before_the_work(tmp_path: Path):
    file, deep = tmp_path / "file", tmp_path / "new" / "folder" / "file.json"
    check_writable(file, None, overwrite=False)
    for inside in (tmp_path / "new", tmp_path / "new" / "folder"):
        check_writable(file, deep, overwrite=False, inside=inside)
    assert list(tmp_path.iterdir()) == []
    with refused(GraspRefineError, deep.parent):
        check_writable(deep, overwrite=True, inside=tmp_path / "other")
    with refused(GraspRefineError, tmp_path):
        check_writable(tmp_path, overwrite=True)
    file.write_text("")
    with refused(GraspRefineError, file / "other"):
        check_writable(file / "other", overwrite=True)
    with refused(GraspRefineError, "file:"):
        check_writable(file, tmp_path / "new" / ".." / "file", overwrite=True, inside=tmp_path)


def test_files_that_exist_are_kept_unless_asked(tmp_path: Path):
    file, link, pipe = tmp_path / "file", tmp_path / "link", tmp_path / "pipe"
    file.write_text("kept")
    link.symlink_to(file)
    os.mkfifo(pipe)
    for path in (file, link):
        with refused(GraspRefineError, path, "--overwrite"):
            check_writable(path, overwrite=False)
        check_writable(path, overwrite=True)
    for device in (pipe, Path("/dev/stdout"), Path("/dev/null")):
        check_writable(device, overwrite=False)
    check_writable(Path("/dev/null"), Path("/dev/null"), overwrite=False)


# Names and versions


def test_result_files_have_names_that_any_file_system_takes(tmp_path: Path):
    paths = result_paths(tmp_path, "claw", ("mug", "box:1,2,3", "a/b", "a b"))
    assert [path.name for path in paths.values()] == [
        "claw_mug.npz", "claw_box_1,2,3.npz", "claw_a_b.npz", "claw_a_b_.npz"
    ]  # fmt: skip


def test_requirements_are_those_of_the_project():
    needs = {need.name: need for need in requirements()}
    assert needs["torch"].range == ">=2.6,<2.14" and needs["torch"].extra is None
    assert needs["viser"].extra == "viewer"
    assert versions()["numpy"] == np.__version__


@pytest.mark.parametrize(
    ("bounds", "problem"),
    [(">=1.26,<3", ""), (">=999", "too old"), ("<1", "too new"), ("", ""), (f">={np.__version__}", "")],
)
def test_versions_are_compared_as_numbers(bounds: str, problem: str):
    assert Requirement("numpy", bounds).problem == problem


def test_a_missing_package_is_missing():
    assert Requirement("no-such-package", ">=1").problem == "missing"
