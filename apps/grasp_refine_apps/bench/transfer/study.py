"""Benchmark of transfers: grasps of one hand as grasps of others, in several ways, tried in simulation."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np

from grasp_refine.core.plurals import count_text
from grasp_refine.hands.hand import load_hand
from grasp_refine.measures.fidelity import SAME_M, Likeness
from grasp_refine.objects.source import check_object_name
from grasp_refine.problem.spec import ProblemSpec
from grasp_refine.scene.protocols.dexgraspbench import DEXGRASPBENCH
from grasp_refine_apps.bench.chart import Row
from grasp_refine_apps.bench.jobs import Job
from grasp_refine_apps.bench.report import Column, Note, Report, Table, failed_table, interval
from grasp_refine_apps.bench.success.assets import EMBEDDED_OBJECTS
from grasp_refine_apps.bench.success.cases import SAMPLED, Axes, Case
from grasp_refine_apps.bench.success.trials import Trial
from grasp_refine_apps.bench.transfer.measure import WAYS, Measured, Measurement

SOURCE_HAND = "allegro"
"""Hand of the embedded examples."""
TARGETS = ("leap", "shadow_palm", "franka_hand")
"""Embedded hands that get the grasps."""

INTRO = (
    "Grasps of one hand are brought to another in three ways. Joint copy: the palm is laid over the palm, and each "
    "finger bends as far as the finger in whose place it is. Kinematics: fingers are placed on the contacts of "
    "the original. Transfer: these grasps are refined. All are closed and tried in MuJoCo. Off is the distance of the "
    "thumb and of the finger that presses against it from the original's contacts, the larger one, of the grasps in "
    f"which both touch. A grasp is the same up to {1e3 * SAME_M:g} mm, if it drops no finger. The palm's shift is from "
    "where it was laid over the other palm. A last row of jaws is of the grasps whose opposing fingers are no farther "
    "apart than the jaws open. Intervals are Wilson's, 95 %."
)


@dataclass(frozen=True)
class TransferStudy:
    """Settings of a run."""

    measurement: Measurement = field(default_factory=lambda: Measurement(Trial(DEXGRASPBENCH)))
    """Settings of each case."""
    source_hand: str = SOURCE_HAND
    """Hand of the embedded examples, where there are no assets."""
    on: tuple[str, ...] = ()
    """Names of the objects; none: all of the assets, or `EMBEDDED_OBJECTS`."""
    to: tuple[str, ...] = TARGETS
    """Hands that get the grasps, as for `run`."""
    assets: Path | None = None
    """Folder of hands, objects and grasps; None: the embedded examples."""
    generators: tuple[str, ...] = ()
    """Grasp files of the assets, NAME or NAME:N."""
    workers: int = 1
    """Processes."""

    def jobs(self, say: Callable[[str], None]) -> list[Job]:
        """Return a job for each source of grasps on each object and each hand that gets them.

        Raises:
            GraspRefineError: there is no such object, hand or grasp file.
        """
        for hand in self.to:
            load_hand(hand)
        if self.assets is None:
            for name in self.on:
                check_object_name(name)
            cases = [
                Case(ProblemSpec(hand=self.source_hand, object=name), self.source_hand, "examples")
                for name in self.on or EMBEDDED_OBJECTS
            ]
        else:
            cases = [
                case
                for case in Axes(assets=self.assets, on=self.on, generators=self.generators).cases()
                # A hand with several models is the source once.
                if case.spec.mjcf is None and case.source != SAMPLED
            ]
        run = self.measurement.run
        return [Job(f"{case.name} to {hand}", partial(run, case, hand)) for hand in self.to for case in cases]

    def rows(self, done: Sequence[Sequence[Measured]]) -> list[Row]:
        """Return a row for each source, hand and way."""
        every = [one for case in done for one in case]
        rows = []
        for key in dict.fromkeys((one.source, one.hand) for one in every):
            by_way = {way: [one for one in every if (one.source, one.hand, one.way) == (*key, way)] for way in WAYS}
            rows += [_row(some) for some in by_way.values()]
            refined = by_way[WAYS[-1]]
            if 0 < sum(int(one.fits.sum()) for one in refined) < sum(len(one.fits) for one in refined):
                rows.append(_row(refined, fitting=True))
        return rows

    def report(self, rows: Sequence[Row], problems: Sequence[str]) -> Report:
        """Return a table for each source."""
        parts: list[Note | Table] = [Note(INTRO, only=None)]
        for source in dict.fromkeys(row["source"] for row in rows):
            lines = [row for row in rows if row["source"] == source]
            parts.append(Table(f"{source}, {count_text(lines[0]['grasps'], 'grasp')} to each hand", COLUMNS, lines))
        return Report("Transfers of grasps", [*parts, *failed_table(problems)])


def _row(some: Sequence[Measured], *, fitting: bool = False) -> Row:
    """Return the numbers of some results of one way; of the grasps alone that fit between the jaws, if `fitting`."""
    fits = np.concatenate([one.fits | (not fitting) for one in some])
    held, pinch, words, palm = (
        np.concatenate([getattr(one, name) for one in some])[fits] for name in ("held", "pinch_m", "fidelity", "palm_m")
    )
    one = some[0]
    return {
        "label": f"{one.hand}: {one.way}" + (", as wide as the jaws open" if fitting else ""),
        "source": one.source,
        "hand": one.hand,
        "way": one.way,
        "grasps": len(held),
        **interval("held", held),
        "pinch_m": float(np.nanmedian(pinch)) if np.isfinite(pinch).any() else None,
        "pinched": float(np.isfinite(pinch).mean()),
        **{each.value: int((words == each.value).sum()) for each in Likeness},
        "palm_m": float(np.median(palm)),
        "cpu_s": sum(each.cpu_s for each in some) / len(fits),
    }


COLUMNS = (
    Column("label", "hand and way"),
    Column("held", "held", "%", ".1f", "higher"),
    Column("held_lower", "from", "%", ".1f", only="page", hint="lower end of the interval"),
    Column("held_upper", "to", "%", ".1f", only="page", hint="upper end of the interval"),
    Column(
        "pinch_m", "off", "mm", ".1f", "lower", hint="thumb and opposing finger, from the original's contacts; median"
    ),
    Column("pinched", "touch", "%", ".0f", "higher", hint="grasps in which both touch"),
    Column(Likeness.SAME.value, "same", form="d", better="higher", hint="same grasp"),
    Column(Likeness.MOVED.value, "moved", form="d", hint="contacts moved"),
    Column(Likeness.DROPPED.value, "dropped", form="d", hint="fingers dropped"),
    Column(Likeness.OTHER.value, "other", form="d", better="lower", hint="another grasp"),
    Column("palm_m", "palm", "mm", ".0f", hint="shift of the palm; median"),
    Column("cpu_s", "CPU", "s", ".2f", hint="of a grasp"),
)
