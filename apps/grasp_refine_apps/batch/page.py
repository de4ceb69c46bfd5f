"""Report of a batch: one HTML file with distributions, pictures of the worst cases and all failures."""

from __future__ import annotations

import shlex
from base64 import b64encode
from collections.abc import Iterable, Iterator, Mapping, Sequence
from math import isnan
from pathlib import PurePath
from typing import Any
from urllib.parse import quote

from grasp_refine.core.plurals import count_text, whole
from grasp_refine.measures.measures import COMPARED, SIDES, Measure
from grasp_refine.refinement.solvers.status import Status
from grasp_refine.results.verdict import BAR
from grasp_refine_apps.batch import words
from grasp_refine_apps.batch.chart import CHARTED, chart, hint, statistics_row
from grasp_refine_apps.batch.failed import failed_text, left_over, suspected_text
from grasp_refine_apps.batch.headline import Verdict, headline_tiles
from grasp_refine_apps.batch.pictures import Picture
from grasp_refine_apps.batch.statistics import Statistics, Tally
from grasp_refine_apps.report.html_page import rendered

MAX_KINDS, MAX_SHARDS_PER_KIND, MAX_JOBS = 30, 20, 500
"""Maximum numbers of listed kinds of failures, shards of each kind, and jobs."""

ADVICE = {status.label: status.advice for status in Status}


def page(document: Mapping[str, Any], statistics: Statistics, pictures: Sequence[Picture]) -> str:
    """Format the report of a batch as HTML; the same input gives the same text.

    Args:
        document: JSON document of the batch.
        statistics: Statistics of all grasps of complete shards.
        pictures: Pictures of the worst cases.
    """
    totals, failed = document.get("totals", {}), document.get("failed", [])
    charts = {measure: chart(measure, statistics.distributions) for measure in CHARTED}
    kinds = list(_failure_kinds(failed))
    pairs, rest = statistics.by_pair()
    rows = [_row(*pair, tally) for pair, tally in pairs]
    if rest.count:
        rows.append(_row("others", "", rest))
    return rendered(
        __package__,
        title=words.grasps(statistics.all.count),
        subtitle=_subtitle(document, statistics),
        tiles=_tiles(totals, statistics, failed),
        agreement=[side.line(f"{name.title()}, ") for name, side in zip(SIDES, statistics.all.agreement, strict=True)],
        changed=[line.plain for line in statistics.changed.lines()],
        bar=BAR,
        notes=list(_notes(totals, failed)),
        simulated=statistics.held is not None,
        panels=[{"title": one.title, "hint": hint(one), "svg": svg} for one, svg in charts.items() if svg],
        numbers=[(one.headline, statistics_row(one, statistics.distributions)) for one, svg in charts.items() if svg],
        pairs=rows,
        cases=[case_entry(picture) for picture in pictures],
        reasons=[
            (name, whole(count), words.share(count, statistics.all.simulated))
            for name, count in _most_frequent(statistics.reasons)
        ],
        statuses=[
            (name, whole(count), words.share(count, statistics.all.count), ADVICE.get(name, ""))
            for name, count in _most_frequent(statistics.statuses)
        ],
        failures=kinds[:MAX_KINDS],
        unlisted=max(len(kinds) - MAX_KINDS, 0),
        costs=list(_costs(totals, statistics)),
        stages=_stages(document.get("profile") or {}),
        jobs=_jobs(document.get("jobs") or []),
        invocation=document.get("invocation", ""),
        versions=document.get("versions", {}),
        settings=list(_flat(document.get("config") or {})),
    )


def _most_frequent(counts: Mapping[str, int]) -> list[tuple[str, int]]:
    """Sort counts, the most frequent first."""
    return sorted(counts.items(), key=lambda entry: (-entry[1], entry[0]))


def _subtitle(document: Mapping[str, Any], statistics: Statistics) -> str:
    hands, objects = ({pair[at] for pair in statistics.pairs} for at in (0, 1))
    more = " or more" if statistics.rest.count else ""
    parts = [
        f"{count_text(len(hands), 'hand')} and {count_text(len(objects), 'object')}{more}" if hands else "",
        count_text(len(document["jobs"]), "job") if document.get("jobs") else "",
        f"seed {document['seed']}" if document.get("seed") is not None else "",
    ]
    return ", ".join(filter(None, parts))


def _tiles(totals: Mapping[str, Any], statistics: Statistics, failed: Sequence[Any]) -> list[dict[str, str]]:
    """Tiles with the most important numbers."""
    tally = statistics.all
    verdicts = [Verdict(f"quality {BAR} (an estimate)", tuple(tally.good.tolist()), tally.count)]
    if statistics.held is not None:
        verdicts.insert(0, Verdict("held in simulation", statistics.held, tally.simulated))
    refined = "grasps refined" if tally.usable == tally.count else f"of {words.grasps(tally.count)} were refined"
    medians = {name: found.quantile(0.5) for name, found in statistics.distributions.items()}
    tiles = [
        *headline_tiles(verdicts, statistics.distributions, medians),
        {"number": whole(tally.usable), "words": refined, "tone": ""},
    ]
    if failed:
        number, kinds = failed_text(failed).split(" ", 1)
        tiles.append({"number": number, "words": f"{kinds} failed", "tone": "bad"})
    if totals.get("grasps_per_s"):
        per, speed = totals.get("cpu_s_per_grasp"), words.rate(totals["grasps_per_s"])
        label = "grasps" if per is None else f"grasps, at {words.duration(per)} of CPU time each"
        tiles.append({"number": speed.replace(" grasps/", " / "), "words": label, "tone": ""})
    return tiles


def _notes(totals: Mapping[str, Any], failed: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    """Notes that qualify the numbers below them."""
    if failed:
        whose = "its" if len(failed) == 1 else "their"
        yield (
            f"{failed_text(failed)} failed{suspected_text(failed)}; these numbers are without {whose} grasps. The "
            "reasons are listed below; the same command tries again."
        )
    left = left_over(totals, failed)
    if left:
        yield (
            f"This is a part of the batch: {whole(left)} of {count_text(totals['shards'], 'shard')} to be done "
            "yet. The same command continues from here."
        )


def _row(hand: str, name: str, tally: Tally) -> dict[str, Any]:
    of = tally.simulated
    return {
        "hand": hand,
        "object": name,
        "count": whole(tally.count),
        "unusable": whole(tally.count - tally.usable) if tally.count > tally.usable else words.NONE,
        "converged": words.share(tally.converged, tally.count),
        "good": [words.share(good, tally.count) for good in tally.good.tolist()],
        "held": [words.share(held, of) for held in tally.held],
        "quality": [f"{value:.3f}" if not isnan(value) else words.NONE for value in tally.mean_quality],
        "deepest": words.millimetres(tally.deepest),
    }


def case_entry(picture: Picture) -> dict[str, Any]:
    """Entries of a case for the macro `figure` of templates; links are relative to the folder of its file."""
    case = picture.case
    measures = (
        _measure_text(one, case.measures[one.name]) for one in COMPARED if not all(map(isnan, case.measures[one.name]))
    )
    missed = f"did not hold: {case.reason}" if case.held is False and case.reason else "did not hold"
    file = PurePath(case.source).name
    origin = f"row {case.source_row} of {file}" if file and case.source_row is not None else file
    return {
        "name": f"{case.hand} on {case.object}",
        "origin": origin,
        "source": case.source,
        "measures": " · ".join(filter(None, (*measures, case.status))),
        "verdict": missed if case.held is False else "",
        "file": case.file.as_posix(),
        "link": quote(case.file.as_posix()),
        "row": case.row,
        # To be run in the folder of the results.
        "command": shlex.join(["refine-grasp", "view", case.file.as_posix(), "--index", str(case.row), *case.look]),
        "pictures": [
            *([("as given", _embedded(picture.before))] if picture.before else []),
            ("refined" if picture.before else "", _embedded(picture.after)),
        ],
        "problem": picture.problem,
    }


def _measure_text(measure: Measure, values: Iterable[float]) -> str:
    """Text for a measure before and after, such as "penetration 1.00 → 0.25 mm"."""
    change = " → ".join(words.NONE if isnan(value) else measure.text(value) for value in values)
    return f"{measure.title} {change} {measure.unit.symbol}".rstrip()


def _embedded(png: bytes) -> str:
    return f"data:image/png;base64,{b64encode(png).decode()}"


def _failure_kinds(failed: Sequence[Mapping[str, Any]]) -> Iterator[dict[str, Any]]:
    """Group failed shards by reason and message, the most frequent first."""
    alike: dict[tuple[str, str], list[Mapping[str, Any]]] = {}
    for one in failed:
        alike.setdefault((one["reason"], one["message"]), []).append(one)
    for (reason, message), shards in sorted(alike.items(), key=lambda entry: (-len(entry[1]), entry[0])):
        yield {
            "reason": reason,
            "message": message,
            "count": failed_text(shards),
            "shards": shards[:MAX_SHARDS_PER_KIND],
            "more": max(len(shards) - MAX_SHARDS_PER_KIND, 0),
            "traceback": shards[0].get("traceback", ""),
        }


def _costs(totals: Mapping[str, Any], statistics: Statistics) -> Iterator[tuple[str, str]]:
    """Times and memory, of this run and per grasp."""
    entries = (
        ("wall time", "wall_s", words.duration),
        ("CPU time", "cpu_s", words.duration),
        ("throughput", "grasps_per_s", words.rate),
        ("CPU time per grasp", "cpu_s_per_grasp", words.duration),
        ("largest process", "peak_bytes", words.mebibytes),
        ("shards", "shards", whole),
        ("done in this run", "done", whole),
    )
    for name, key, formatter in entries:
        if totals.get(key) is not None:
            yield name, formatter(totals[key])
    spent = statistics.distributions["cpu_s"]
    if spent.count:
        low, high, most = spent.quantile(0.5), spent.quantile(0.95), spent.most
        yield (
            "refining a grasp",
            f"{words.duration(spent.mean)} of CPU time in the mean, median {words.duration(low)}, 19 of 20 at most "
            f"{words.duration(high)}, the slowest {words.duration(most)}",
        )
    steps = statistics.distributions["iterations"]
    if steps.count:
        yield "iterations", f"{steps.mean:.0f} in the mean, {steps.most:.0f} at most"


def _stages(profile: Mapping[str, Mapping[str, float]]) -> list[tuple[str, str, str, str, str]]:
    """Time of each stage, the longest first."""
    total = sum(spent["cpu_s"] for spent in profile.values())
    ranked = sorted(profile.items(), key=lambda entry: -entry[1]["cpu_s"])
    return [
        (
            name,
            f"{spent['cpu_s']:.2f}",
            f"{100 * spent['cpu_s'] / total:.1f} %" if total else words.NONE,
            f"{spent['wall_s']:.2f}",
            whole(int(spent["calls"])),
        )
        for name, spent in ranked
        if spent["cpu_s"] or spent["calls"]
    ]


def _jobs(jobs: Sequence[Mapping[str, Any]]) -> dict[str, Any] | None:
    """Table of jobs, with a column for each of their entries."""
    if not jobs:
        return None
    names = list(dict.fromkeys(name for job in jobs for name in job))
    more = "" if len(jobs) <= MAX_JOBS else f", the first {MAX_JOBS}"
    return {
        "count": f"{count_text(len(jobs), 'job')}{more}",
        "names": names,
        "rows": [[_cell(job.get(name)) for name in names] for job in jobs[:MAX_JOBS]],
    }


def _cell(value: Any) -> dict[str, Any]:
    number = isinstance(value, int | float) and not isinstance(value, bool)
    return {
        "text": words.NONE if value is None else f"{value:g}" if isinstance(value, float) else value,
        "number": number,
    }


def _flat(config: Any, name: str = "") -> Iterator[tuple[str, str]]:
    """Flatten settings to names and values; nested settings get the names of their parents as prefix."""
    if isinstance(config, Mapping):
        for key, value in config.items():
            yield from _flat(value, f"{name}.{key}" if name else str(key))
    elif isinstance(config, list | tuple):
        yield name, ", ".join(map(str, config)) or words.NONE
    else:
        yield name, words.NONE if config is None else str(config)
