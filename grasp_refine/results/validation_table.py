"""Tables for people after a validation: grasps that held, failures with their reasons, before and after."""

from __future__ import annotations

import json
from collections.abc import Sequence
from itertools import combinations

import numpy as np
from rich.console import Group, RenderableType
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from grasp_refine.core.plurals import count_text
from grasp_refine.measures.formulas import COSTLY_M
from grasp_refine.results.simulated import reason_lines
from grasp_refine.results.table import (
    by_object,
    listed,
    measure_text,
    number_text,
    numbers_text,
    plain_table,
)
from grasp_refine.results.validation_document import QUANTILES
from grasp_refine.results.verdict import Agreement, estimate_line, held_line, should_hold
from grasp_refine.scene.contact_selection import CONTACT_DISTANCE_M
from grasp_refine.scene.protocols.protocol import Protocol
from grasp_refine.validation.creep import softer_options
from grasp_refine.validation.engine_agreement import EngineAgreement
from grasp_refine.validation.engine_table import ENGINES, MUJOCO
from grasp_refine.validation.trials import Reason, Trials
from grasp_refine.validation.validate import BARELY, MIN_CONTACT_LINKS, Validated

_MAX_DIRECTIONS = 3
"""Largest number of directions that are named in a cell."""


def validation_table(
    validated: Validated, hand: str, protocol: Protocol | None, frictions: Sequence[float], *, verbose: bool = False
) -> RenderableType:
    """Return tables of all grasps by object and a verdict; of many grasps only the worst, unless `verbose`."""
    parts = by_object(
        validated.object,
        lambda name, rows: _object_table(validated.select(rows), f"{hand} on {name}", protocol, verbose),
    )
    names = list(dict.fromkeys(validated.object.tolist()))
    if len(names) > 1 and protocol is not None:
        parts += [_by_object(validated, names), ""]
    return Group(*parts, *_verdict(validated, protocol, frictions), *_misplaced(validated), *_engines(validated))


def comparison_table(before: Validated, after: Validated, hand: str, protocol: Protocol | None) -> RenderableType:
    """Return the changes between two validations of the same grasps, in the mean and in the verdicts."""
    table = plain_table(f"{hand}: {count_text(len(after), 'grasp')}, before → after")
    table.add_column("")
    for column in ("before", "after", "better in", "worse in"):
        table.add_column(column, justify="right", no_wrap=True)
    for measure in after.metrics.measures:
        old, new = (v.metrics.values[measure.name] * measure.unit.factor for v in (before, after))
        known = np.isfinite(old) & np.isfinite(new)
        if not (measure.compared and measure.shown and known.any()):
            continue
        better = (new[known] - old[known]) * (1 if measure.better == "higher" else -1)
        table.add_row(
            f"{measure.title}, mean {measure.unit.symbol}".rstrip(),
            f"{old[known].mean():.3f}",
            f"{new[known].mean():.3f}",
            str(int((better > 1e-9).sum())),
            str(int((better < -1e-9).sum())),
        )
    lost_all = [int(np.isnan(v.metrics.wrench_residual).sum()) for v in (before, after)]
    if any(lost_all):
        table.add_row("without any contact", *map(str, lost_all), "", "")
    first: list[Text] = []
    parts: list[RenderableType] = []
    if protocol is not None:
        gained, lost = after.success & ~before.success, before.success & ~after.success
        held = int(before.success.sum()), int(after.success.sum())
        first = [held_line(protocol.label, held, int(gained.sum()), int(lost.sum()), len(after))]
        table.add_row(
            f"held, {protocol.label}",
            f"{before.success.sum()} ({_percent(before.success)})",
            f"{after.success.sum()} ({_percent(after.success)})",
            str(int(gained.sum())),
            str(int(lost.sum())),
            style="bold",
        )
        for word, which in (("gained", gained), ("lost", lost)):
            if which.any():
                parts.append(Text(f"{word}: {_numbers(after, which)}"))
    return Group(*first, table, "", *parts)


def _object_table(validated: Validated, what: str, protocol: Protocol | None, verbose: bool) -> Table:
    title = f"{what}: {count_text(len(validated), 'grasp')}"
    if protocol is not None:
        title += ", ".join(["", protocol.name, f"friction {protocol.friction:g}", *protocol.contact_points])
        if protocol.density is not None and validated.mass is not None:
            title += f", {validated.mass[0] * 1e3:.0f} g"
        if protocol.seconds != Protocol().seconds:
            title += f", {'lift' if protocol.tabletop else 'pushes'} of {protocol.seconds:g} s"
    shown, title = listed(np.argsort(-_badness(validated), kind="stable"), title, verbose)
    table = plain_table(title, between=0)
    # Beside a simulation not all measures fit.
    columns = [
        each
        for each in validated.metrics.measures
        if any(each.head) and not (protocol is not None and each.name == "wrench_residual")
    ]
    for head in ("\n grasp", *("\n".join(each.head) for each in columns)):
        table.add_column(head, justify="right", no_wrap=True)
    if protocol is not None:
        table.add_column("   moved\nmm   deg", justify="right", no_wrap=True)
        table.add_column("\n verdict")
    for i in shown:
        measures = (measure_text(each, validated.metrics.values[each.name][i]) for each in columns)
        table.add_row(str(validated.index[i]), *measures, *_simulated(validated, int(i), protocol))
    if len(validated) > 1:
        table.add_section()
        medians = (measure_text(each, _median(validated.metrics.values[each.name])) for each in columns)
        last = [] if protocol is None else ["", f" {validated.success.sum()} held, {_percent(validated.success)}"]
        table.add_row("median", *medians, *last, style="bold")
    return table


def _badness(validated: Validated) -> np.ndarray:
    """Return sort keys: failures first, then by displacement of the object; without simulation by quality."""
    if validated.trials is None:
        return -np.nan_to_num(validated.metrics.quality, nan=-1.0)
    moved = np.nan_to_num(validated.trials.displacement_m.max(axis=1), nan=1e3)
    return np.where(validated.success, 0.0, 1e6) + moved


def _simulated(validated: Validated, i: int, protocol: Protocol | None) -> list[RenderableType]:
    """Return cells on the simulation of a grasp; none without one."""
    trials = validated.trials
    if protocol is None or trials is None:
        return []
    # As in the line on objects that were held; of a lost one, at its failure.
    if trials.success[i]:
        metres, radians = trials.most("peak_m")[i], trials.most("peak_rad")[i]
    else:
        metres, radians = trials.displacement_m[i, trials.worst[i]], trials.angle_rad[i, trials.worst[i]]
    moved = f"{number_text(1e3 * metres, 1):>5} {number_text(np.degrees(radians), 1):>5}"
    return [moved, _reason(validated, i, protocol)]


def _reason(validated: Validated, i: int, protocol: Protocol) -> Text:
    trials = validated.trials
    assert trials is not None
    worst = trials.worst[i]
    reason = Reason(trials.outcome[i])
    failed = np.flatnonzero(trials.reason[i] != Reason.HELD)
    count = len(trials.directions)
    if reason == Reason.HELD:
        pushed = trials.pushed(i)
        flags = [
            word
            for word, flagged in (
                ("barely", validated.barely(protocol)[i]),
                # A guess, unless it was simulated.
                ("by the squeeze" + ("?" if validated.unsqueezed is None else ""), validated.by_squeeze[i]),
                (pushed, pushed),
            )
            if flagged
        ]
        if trials.label is not None:
            flags.append(f"{trials.label[i]:.0%} elsewhere")
        if validated.noise is not None:
            flags.append(f"noise {validated.noise[i]:.0%}")
        held = f" held{f' in {count - len(failed)} of {count}' if len(failed) else ''}"
        return Text(f"{held}{', ' + ', '.join(flags) if flags else ''}", "yellow" if flags else "green")
    if reason == Reason.PENETRATES:
        return Text(f" penetrates {trials.penetration_m[i] * 1e3:.0f} mm at first", "red")
    if reason == Reason.EJECTED_WHILE_CLOSING:
        return Text(f" ejected {trials.closing_m[i] * 1e3:.0f} mm while closing", "red")
    if reason == Reason.OFF_CENTRE:
        assert trials.label is not None
        return Text(f" off centre, {trials.label[i]:.0%} held elsewhere", "red")
    if reason == Reason.HAND_UNSTABLE and trials.runaway is not None:
        return Text(f" {reason.label}: {trials.runaway[i]}", "red")
    if reason in (Reason.IN_TABLE, Reason.NOT_FINITE, Reason.OUT_OF_REACH) or np.isnan(trials.time_s[i, worst]):
        return Text(f" {reason.label}", "red")
    where = " ".join(trials.directions[d] for d in failed)
    if len(failed) > _MAX_DIRECTIONS:
        where = f"all {count}" if len(failed) == count else f"{len(failed)} of {count}"
    return Text(
        f" {reason.label} {where}, {trials.time_s[i, worst]:.1f} s, {trials.contacts[i, worst].sum()} left", "red"
    )


def _by_object(validated: Validated, names: Sequence[str]) -> Table:
    table = plain_table(f"all {len(names)} objects: {count_text(len(validated), 'grasp')}")
    for column in ("object", "grasps", "held", ""):
        table.add_column(column, justify="left" if column == "object" else "right", no_wrap=column != "object")
    for name in names:
        held = validated.success[validated.object == name]
        table.add_row(escape(name), str(len(held)), str(int(held.sum())), _percent(held))
    return table


def _verdict(validated: Validated, protocol: Protocol | None, frictions: Sequence[float]) -> list[Text]:
    trials, quality = validated.trials, validated.metrics.quality
    if trials is None or protocol is None:
        return [estimate_line(int(should_hold(quality).sum()), None, len(quality))]
    success = validated.success
    color = "green" if success.all() else "yellow"
    held = f"{success.sum()} of {count_text(len(success), 'grasp')} held"
    lines = [Text.assemble((held, color), f" ({_percent(success)}) {protocol.rule}")]
    if protocol.palm == "soft weld" and MUJOCO in validated.engines:
        lines.append(Text("palm on a soft weld, as in DexGraspBench: it gives way under load; other protocols hold it"))
    if trials.label is not None:
        lines.append(Text(f"mean label {trials.label.mean():.3f}: share of the trials elsewhere that held"))
    lines += [*reason_lines(trials, protocol), *_creep(validated, protocol)]
    lines.append(Agreement.of(should_hold(quality), success).line())
    if success.any():
        parts = []
        for values, factor, unit in (
            (trials.most("peak_m"), 1e3, "mm"),
            (np.degrees(trials.most("peak_rad")), 1, "deg"),
        ):
            most = values[success]
            parts.append(" / ".join(f"{np.quantile(most, q) * factor:.1f}" for q in QUANTILES) + f" {unit}")
        words = " / ".join(QUANTILES.values())
        lines.append(Text(f"objects that were held moved {parts[0]} and rotated {parts[1]} ({words})"))
    barely = validated.barely(protocol)
    if barely.any():
        limits = " or ".join(protocol.bounds(BARELY))
        lines.append(
            Text.assemble(
                (f"{barely.sum()} held only barely", "yellow"),
                f" (moved more than {limits}): {_numbers(validated, barely)}",
            )
        )
    squeezed = validated.by_squeeze
    if squeezed.any():
        near = f"fewer than {MIN_CONTACT_LINKS} links within {CONTACT_DISTANCE_M * 1e3:g} mm of the object before it"
        how = near if validated.unsqueezed is None else "fails without"
        perhaps = "perhaps " if validated.unsqueezed is None else ""
        lines.append(
            Text.assemble(
                (f"{squeezed.sum()} held {perhaps}only by the squeeze", "yellow"),
                f" ({how}): {_numbers(validated, squeezed)}",
            )
        )
    if validated.noise is not None:
        mean = validated.noise.mean()
        lines.append(Text(f"with the object shifted and rotated at random, {mean:.0%} of the trials held"))
    if validated.frictions is not None:
        shares = (f"{f:g}: {_percent(h)}" for f, h in zip(frictions, validated.frictions.T, strict=True))
        lines.append(Text(f"held by friction: {', '.join(shares)}"))
    return lines


def _creep(validated: Validated, protocol: Protocol) -> list[Text]:
    """Return a line on lost grasps whose verdict hangs on creep, with the contacts that stop it."""
    creeps = validated.by_creep
    if validated.creep is None or not creeps.any():
        return []
    metres, radians = np.median(validated.creep[creeps], axis=0)
    options = ", ".join(f"{name} = {json.dumps(value)}" for name, value in softer_options(protocol.contact).items())
    lost = count_text(int((~validated.engines[MUJOCO].success).sum()), "lost grasp")
    return [
        Text.assemble(
            (f"{creeps.sum()} of {lost} hang on creep", "yellow"),
            f" of MuJoCo's contacts: they hold in firm contacts; here their objects drift by {metres * 1e3:.1f} mm and "
            f"{np.degrees(radians):.1f} degrees (median) in {protocol.seconds:g} s with no push. To judge the grasp, "
            f"set in the protocol: [contact] {options}",
        )
    ]


def _misplaced(validated: Validated) -> list[Text]:
    """Return lines on grasps with links where they should not be, where there are regions or a scene."""
    lines = []
    for name, good in (
        ("region_miss_m", "touch only where they should"),
        ("scene_penetration_m", "in no body of the scene"),
    ):
        values = validated.metrics.values[name]
        known, wrong = np.isfinite(values), values > COSTLY_M[0]
        if known.any():
            others = f"; not: {_numbers(validated, wrong)}" if wrong.any() else ""
            count = f"{(known & ~wrong).sum()} of {len(values)}"
            lines.append(Text.assemble(f"{good}: ", (count, "yellow" if wrong.any() else "green"), others))
    return lines


def _engines(validated: Validated) -> list[RenderableType]:
    """Return how far each two engines agree, and the grasps on which they do not, with each one's reason."""
    parts: list[RenderableType] = []
    for first, second in combinations(validated.engines, 2):
        titles = ENGINES[first].title, ENGINES[second].title
        one, other = validated.engines[first], validated.engines[second]
        agreement = EngineAgreement.of(one.success, other.success)
        counts = plain_table(" and ".join(titles))
        for column in ("", f"held in {titles[1]}", f"lost in {titles[1]}"):
            counts.add_column(column, justify="right", no_wrap=True)
        counts.add_row(f"held in {titles[0]}", str(agreement.both), str(agreement.first_only))
        counts.add_row(f"lost in {titles[0]}", str(agreement.second_only), str(agreement.neither))
        beyond = "" if np.isnan(agreement.kappa) else f", Cohen's kappa {agreement.kappa:.2f}"
        parts += ["", counts, Text(f"they agree on {100 * agreement.share:.1f} %{beyond}")]
        unlike = np.flatnonzero(one.success != other.success)
        if len(unlike):
            table = plain_table("grasps on which they do not")
            for column in ("object", "grasp", *titles):
                table.add_column(column, justify="right" if column == "grasp" else "left")
            for i in unlike:
                reasons = (_lost_text(trials, int(i)) for trials in (one, other))
                table.add_row(escape(str(validated.object[i])), str(validated.index[i]), *reasons)
            parts += ["", table]
    return parts


def _lost_text(trials: Trials, i: int) -> str:
    """Return the verdict on a grasp: its reason, directions and moment, and the contacts that it has lost by then."""
    worst = int(trials.worst[i])
    reason = Reason(trials.reason[i, worst])
    lost = [name for name, each in zip(trials.directions, trials.reason[i], strict=True) if each != Reason.HELD]
    if not lost:
        moved = f"{trials.peak_m[i, worst] * 1e3:.1f} mm, {np.degrees(trials.peak_rad[i, worst]):.1f} deg"
        return f"{reason.label}, moved {moved} at most"
    text = f"{reason.label} {' '.join(lost)}"
    if np.isnan(trials.time_s[i, worst]):
        return text
    left = trials.contacts_squeeze[i] & ~trials.contacts[i, worst]
    names = [trials.links[link] for link in np.flatnonzero(left)]
    return f"{text} after {trials.time_s[i, worst]:.1f} s, {'without ' + ', '.join(names) if names else 'all links on'}"


def _numbers(validated: Validated, which: np.ndarray) -> str:
    return numbers_text(validated.object, validated.index, which)


def _median(values: np.ndarray) -> float:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if len(known) else np.nan


def _percent(held: np.ndarray) -> str:
    return f"{100 * held.mean():.1f} %"
