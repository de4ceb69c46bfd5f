"""`refine-grasp convert`: convert grasp files of one program to another's."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Annotated

import numpy as np
from rich.console import Console
from rich.progress import Progress
from tyro.conf import DisallowNone, Positional, arg

from grasp_refine.core.array_types import Int
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.json_files import check_no_input, check_writable
from grasp_refine.core.plurals import count_text
from grasp_refine.grasps.formats.agreement import MAX_DIFFERENCE_M, DisagreementError, check_agreement, check_same
from grasp_refine.grasps.formats.format import Load
from grasp_refine.grasps.formats.listing import FORMATS, OURS
from grasp_refine.grasps.formats.reading import Reading, reading
from grasp_refine.grasps.formats.writing import check_output, written
from grasp_refine.grasps.grasp_set import GraspSet, match_joints
from grasp_refine.grasps.rows import best_rows, rows_where
from grasp_refine.hands.files.source import check_known, is_known
from grasp_refine.hands.hand import Hand, load_hand
from grasp_refine.measures.measures import QUALITY
from grasp_refine.problem.named_inputs import on_disk
from grasp_refine.results.result_numbers import result_values
from grasp_refine.scene.convention_check import joint_notes, position_notes, refuse_conventions
from grasp_refine_apps.commands.format_names import FormatName
from grasp_refine_apps.commands.options import NOTHING_USABLE, OptionalFile, Overwrite, check_numbers
from grasp_refine_apps.report.json_document import save_document
from grasp_refine_apps.report.screen import screen

NUM_CANDIDATES = 16
"""Number of surface points per link; they are not used here."""


@dataclass(frozen=True)
class Convert:
    """Write the grasps of one program as files of another: joints by name, frames and scales as each format has them.

    ours: one .npz file with everything. dexgraspbench, dexonomy, hugs: folders with one .npy file per grasp. bodex,
    dexgraspnet: folders with one .npy file per object. leap_cache: one .npy file of the LEAP hand with a cube.
    multidex, dro: one .pt file. graspqp: a folder with one .pt file per object. isaac_grasp (.yaml), lightning_grasp
    (.pt), acronym (.h5), multigripper (.json): one file per object. The others are read only.

    Before a file takes its place, it is read again: fingertips must agree to 1e-6 m, which shows that nothing was lost
    in the conversion; poses and joints where the hand is unknown. A folder is never replaced. Pickles and torch
    files are read without executing them. Non-finite grasps are left out, and counted.
    """

    source: Annotated[Positional[Path], arg(metavar="IN")]
    """A grasp file, or a folder of them."""
    output: Annotated[Positional[Path], arg(metavar="OUT")]
    """Output file, or a new folder."""
    to: FormatName
    """Output format."""
    format: Annotated[DisallowNone[FormatName | None], arg(help_behavior_hint="(default: detected)")] = None
    """Format of IN."""
    hand: Annotated[DisallowNone[str | None], arg(help_behavior_hint="(default: that of IN)")] = None
    """Hand of the grasps: a name from `refine-grasp hands`, a folder, or a URDF or MJCF file. Required if IN
    names neither hand nor joints and fits several hands."""
    urdf: Annotated[DisallowNone[Path | None], arg(metavar="FILE", help_behavior_hint="(default: its own)")] = None
    """URDF of the hand, if it ships without one."""
    where: Annotated[tuple[str, ...], arg(metavar="CONDITION [...]", help_behavior_hint="(default: all)")] = ()
    """Only grasps that fulfil all of these conditions, on labels (success=1, energy<2) or, of refined grasps, on
    measures (quality>=0.9, penetration_m<0.001), whether they held in simulation (held=1; held_mujoco=1 in
    an engine), and what changed ("change=contacts moved")."""
    best: Annotated[DisallowNone[int | None], arg(metavar="N", help_behavior_hint="(default: all)")] = None
    """Of these, only the N refined grasps of each object of highest quality."""
    as_is: Annotated[bool, arg(help_behavior_hint="")] = False
    """Whether to accept joint values that look like degrees, and positions that look like millimetres."""
    json: OptionalFile = None
    """Write a summary of the conversion to this file."""
    overwrite: Overwrite = False

    def execute(self) -> int:
        """Run the command and return its exit code.

        Raises:
            GraspRefineError: an input that cannot be used; then nothing is written.
        """
        began = time.perf_counter()
        check_numbers(self)
        outputs = [path for path in (self.output, self.json) if path is not None]
        for path in outputs:
            check_no_input(path, (self.source,), "is the input; give another name")
        # Whether OUT becomes a folder is known only after the grasps are read.
        check_writable(self.json, None if self.output.is_dir() else self.output, overwrite=self.overwrite)
        messages, console = screen(stderr=True), screen()
        hand = None if self.hand is None else load_hand(self.hand, urdf=self.urdf, candidates=NUM_CANDIDATES)
        with Progress(console=messages, transient=True, disable=not messages.is_terminal) as bar:
            task = bar.add_task("reading", total=None)
            read = reading(
                on_disk(self.source, messages.print),
                format=self.format,
                hand=hand,
                on_file=lambda done, total: bar.update(task, completed=done, total=total),
            )
            for path in outputs:
                check_no_input(path, read.files, "is one of the files of the input; give another name")
            wanted = self._rows(read)
            grasps, left = read.grasps.select(wanted), len(read.grasps) - len(wanted)
            to, load = FORMATS[self.to], self._load(grasps)
            parts, lost = to.write(grasps, load)
            if left:
                lost = [*lost, f"{left} of {len(read.grasps)} grasps {'is' if left == 1 else 'are'} left out"]
            check_output(self.output, to, parts)
            bar.update(task, description="writing and checking", total=None)
            known_hand = self.hand is not None or is_known(grasps.hand)
            loaded = load(grasps.base_link) if known_hand else None
            doubts = position_notes(grasps.hand_pose)
            if loaded is not None:
                doubts = (*joint_notes(loaded, match_joints(grasps, loaded)[0]), *doubts)
            if not self.as_is:
                refuse_conventions(doubts, str(self.source))
            # They may explain a written file that does not agree.
            _print_notes(doubts, messages)
            try:
                with written(self.output, to, parts) as (place, rows):
                    again = reading(place, format=self.to, hand=loaded)
                    chosen = grasps.select(rows)
                    if again.grasps.hand != grasps.hand and self.hand is None:
                        # A format that does not name the hand.
                        check_known(grasps.hand, self.source)
                    difference = (
                        check_same(chosen, again.grasps)
                        if loaded is None
                        else check_agreement(chosen, again.grasps, load)
                    )
                    changed = _changes(grasps.select(rows), again.grasps)
            except DisagreementError as found:
                messages.print(f"{self.output}: not written: {found}", soft_wrap=True, markup=False)
                return NOTHING_USABLE
        if loaded is None:
            lost = [*lost, f"hand '{grasps.hand}' is unknown here: poses and joints are compared instead of fingertips"]
        notes = tuple(dict.fromkeys([*doubts, *read.notes, *lost, *changed]))
        _print_notes(notes[len(doubts) :], messages)
        save_document(
            self.json,
            "convert",
            {
                "input": {"path": self.source, "format": read.format.name, "files": len(read.files)},
                "output": {"path": self.output, "format": self.to, "files": len(parts)},
                "hand": read.grasps.hand,
                "grasps": len(grasps),
                "left_out": left,
                "objects": Counter(grasps.object.tolist()),
                "largest_difference_m": difference,
                "limit_m": MAX_DIFFERENCE_M,
                "notes": notes,
                "wall_s": time.perf_counter() - began,
            },
        )
        wrote = f"{self.output}: {to.name}, {count_text(len(parts), 'file')}, {count_text(len(grasps), 'grasp')}"
        for line in _summary(read, self.source, wrote, difference, loaded is not None):
            console.print(line, soft_wrap=True, markup=False)
        return 0

    def _rows(self, read: Reading) -> Int[np.ndarray, " chosen"]:
        """Return the rows of the grasps to convert: finite, with all conditions fulfilled, the best of their object.

        Raises:
            GraspRefineError: there is none, or the selected measure is unknown.
        """
        rows = np.flatnonzero(read.grasps.finite)
        if not len(rows):
            raise GraspRefineError(
                f"{self.source}: none of its {len(read.grasps)} grasps is finite: nothing to convert"
            )
        if not self.where and self.best is None:
            return rows
        measured = result_values(read.files) if read.format == OURS else {}
        values = {**measured, **read.grasps.labels}
        for number, condition in enumerate(self.where, start=1):
            rows = np.intersect1d(rows, rows_where(values, condition))
            if not len(rows):
                raise GraspRefineError(
                    f"{self.source}: no grasp has {' and '.join(self.where[:number])}: nothing to convert"
                )
        if self.best is None:
            return rows
        if QUALITY.name not in measured:
            raise GraspRefineError(f"{self.source}: --best needs the quality of refined grasps, which it does not have")
        best = best_rows(measured[QUALITY.name][rows], read.grasps.object[rows], self.best)
        if not len(best):
            raise GraspRefineError(f"{self.source}: no grasp has a quality: nothing to convert")
        return rows[best]

    def _load(self, grasps: GraspSet) -> Load:
        """Return the loader of the hand of the grasps, by base link."""
        source = self.hand or grasps.hand

        @cache
        def load(base_link: str) -> Hand:
            if self.hand is None:
                check_known(source, self.source)
            return load_hand(source, base_link=base_link, urdf=self.urdf, candidates=NUM_CANDIDATES)

        return load


def _print_notes(notes: Sequence[str], console: Console) -> None:
    for note in notes:
        console.print(f"note: {note}", style="dim", soft_wrap=True, markup=False)


def _changes(before: GraspSet, after: GraspSet) -> list[str]:
    """Return descriptions of the objects and scales that are read as others."""
    pairs = zip(*(_object_texts(grasps) for grasps in (before, after)), strict=True)
    return [f"{one} will be read as {two}" for one, two in dict.fromkeys(pairs) if one != two]


def _object_texts(grasps: GraspSet) -> Sequence[str]:
    return [f"object '{n}' of scale {s:g}" for n, s in zip(grasps.object.tolist(), grasps.scale.tolist(), strict=True)]


def _summary(read: Reading, source: Path, wrote: str, difference: float, fingertips: bool) -> list[str]:
    objects = len(np.unique(read.grasps.object))
    what, unit = ("fingertips", " m") if fingertips else ("poses and joints", "")
    return [
        f"read   {source}: {read.format.name}, {count_text(len(read.files), 'file')}",
        f"       {count_text(len(read.grasps), 'grasp')} of hand {read.grasps.hand} on {count_text(objects, 'object')}",
        f"wrote  {wrote}",
        f"check  read again, {what} differ by at most {difference:.2g}{unit} (limit {MAX_DIFFERENCE_M:g}{unit})",
    ]
