"""`refine-grasp hands`: included hands, the interpretation of one hand, or trials of several."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

from rich.console import Console
from tyro.conf import Positional, arg

from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.json_files import check_writable, save_text
from grasp_refine.hands.files.hand_toml import HAND_TOML
from grasp_refine.hands.hand import Hand, list_hands, load_hand, needs_urdf
from grasp_refine.problem.spec import HandSpec, check_hull_limit
from grasp_refine_apps.commands.inputs import Sources
from grasp_refine_apps.commands.option_rules import OptionGroup
from grasp_refine_apps.commands.options import NOTHING_USABLE, OptionalFile, Overwrite
from grasp_refine_apps.report.command_line import flag
from grasp_refine_apps.report.hand_facts import examples, facts_without_urdf, hand_facts
from grasp_refine_apps.report.hand_table import bullets, list_table, show_hand
from grasp_refine_apps.report.json_document import save_document
from grasp_refine_apps.report.screen import screen

if TYPE_CHECKING:
    from grasp_refine_apps.report.hand_check import HandCheck

NUM_CANDIDATES, CHECK_CANDIDATES = 16, 512
"""Number of surface points per link where they are not used, and where pads are looked for."""
TRIED_CANDIDATES = 1024
"""Number of surface points per link of a hand that is tried, as everywhere."""
OBJECTS = ("mug", "bottle", "bowl", "rounded_box", "sphere:0.03", "cylinder:0.03,0.12")
"""Objects on which hands are tried: embedded ones, and two primitives."""

HAND_FIELDS = tuple(one.name for one in fields(HandSpec))
"""Fields that say how a hand is read."""

NEEDS_HAND = "without a hand, by its name or URDF: refine-grasp hands HAND"


@dataclass(frozen=True)
class Hands(HandSpec):
    """List the hands that ship with the program, show the joints and links of one, or check your own URDF or MJCF."""

    groups: ClassVar[tuple[OptionGroup, ...]] = (
        OptionGroup("hand", "Files of the hand, as for `refine-grasp run`.", ("hands", *HAND_FIELDS)),
        OptionGroup("check", "Show how the files were read and why, and what looks wrong.", ("check", "write", "out")),
        OptionGroup(
            "trial",
            "Sample grasps on some objects, refine and simulate them: a table with a row for each hand.",
            ("tries", "objects", "protocol", "markdown", "seed"),
        ),
        OptionGroup("output", "Facts about the hands.", ("json", "overwrite")),
    )
    metavars: ClassVar[Mapping[str, str]] = Sources.metavars

    hands: Annotated[
        Positional[tuple[str, ...]], arg(metavar="[HAND [HAND ...]]", help_behavior_hint="(default: list all)")
    ] = ()
    """Name from the list, folder with a hand.toml or one URDF, or URDF or MJCF file; several with --check --tries."""
    check: bool = False
    """Show how the files were read and why, and what looks wrong."""
    tries: Annotated[int, arg(help_behavior_hint="(default: none)")] = 0
    """With --check: number of grasps that are sampled on each object, instead of the other checks."""
    objects: Annotated[tuple[str, ...], arg(metavar="OBJECT [...]")] = OBJECTS
    """Objects of --tries, as for `refine-grasp run --object`."""
    protocol: str = "dexgraspbench"
    """Protocol of the simulation with --tries, as for `refine-grasp validate --protocol`."""
    markdown: OptionalFile = None
    """With --tries: write the table to this file."""
    write: bool = False
    """With --check: write a hand.toml to start from beside the URDF or MJCF."""
    out: Annotated[Path | None, arg(metavar="DIR", help_behavior_hint="(default: that of the URDF)")] = None
    """With --write: folder of the hand.toml."""
    seed: int = 0
    """Random seed of the sampling with --tries."""
    json: OptionalFile = None
    """Write the facts about the hands to this file."""
    overwrite: Overwrite = False

    def execute(self) -> int:
        """Run the command and return its exit code.

        Raises:
            GraspRefineError: no such hand, one that cannot be read, or files that cannot be written.
        """
        check_writable(self.json, overwrite=self.overwrite, inside=self.out)
        check_writable(self.markdown, overwrite=self.overwrite)
        check_hull_limit(self.hull_limit)
        if self.tries < 0:
            raise GraspRefineError(f"--tries must be at least 0, got {self.tries}")
        if not self.hands:
            return self._list()
        if self.tries:
            return self._try()
        if self.markdown is not None or len(self.hands) > 1:
            raise GraspRefineError("several hands, and --markdown, go with --check --tries N")
        if (self.write and not self.check) or (self.out is not None and not self.write):
            raise GraspRefineError("--write goes with --check, and --out with both")
        hand = self._load(self.hands[0], CHECK_CANDIDATES if self.check else NUM_CANDIDATES)
        return self._check(hand) if self.check else self._show(hand)

    def _load(self, source: str, candidates: int) -> Hand:
        return load_hand(
            source,
            candidates=candidates,
            **{name: getattr(self, name) for name in HAND_FIELDS},
            progress=lambda line: screen(stderr=True).print(line, markup=False, style="dim", soft_wrap=True),
        )

    def _try(self) -> int:
        """Sample, refine and simulate grasps of each hand; the exit code is that of a table without any grasp."""
        from grasp_refine_apps.bench.hand_trials import name_of, table_of, try_hand

        if not self.check or self.write:
            raise GraspRefineError("--tries goes with --check, and without --write")
        rows = []
        for source in self.hands:
            screen(stderr=True).print(f"{source} ...", markup=False, style="dim", soft_wrap=True)
            load = partial(self._load, source, TRIED_CANDIDATES)
            rows.append(try_hand(load, name_of(source), self.objects, self.tries, self.protocol, self.seed))
        table = table_of(rows, self.tries, self.objects, self.protocol)
        self._save(rows)
        if self.markdown is not None:
            save_text(self.markdown, f"{table.title}\n\n{table.markdown()}\n")
        screen().print(table.printed())
        for row in rows:
            if row["trouble"]:
                screen().print(f"{row['hand']}: {row['trouble']}", markup=False, soft_wrap=True)
        return 0 if any(row["held_after"] is not None for row in rows) else NOTHING_USABLE

    def _list(self) -> int:
        named = [
            flag(name)
            for name in (*HAND_FIELDS, "check", "write", "out")
            if getattr(self, name) != getattr(Hands, name)
        ]
        if named:
            raise GraspRefineError(f"{' and '.join(named)} {NEEDS_HAND} {named[0]}")
        waiting = [name for name in list_hands() if needs_urdf(name)]
        hands = [load_hand(name, candidates=NUM_CANDIDATES) for name in list_hands() if name not in waiting]
        self._save([hand_facts(hand) for hand in hands] + [facts_without_urdf(name) for name in waiting])
        console = screen()
        console.print(list_table(hands, waiting), "")
        for hand in hands:
            for note in hand.notes:
                console.print(f"{hand.name}: {note}", markup=False, soft_wrap=True)
        if waiting:
            console.print(
                f"{', '.join(waiting)}: the URDF is not ours; it is fetched when the hand is used (refine-grasp assets "
                "list hands), or give yours with --urdf FILE",
                markup=False,
            )
        console.print(
            "refine-grasp hands HAND shows the joints, links and contact links of a hand or a URDF file.\n"
            "refine-grasp hands --check my_hand.urdf checks your own URDF; --write writes a hand.toml."
        )
        return 0

    def _show(self, hand: Hand) -> int:
        # This loads torch and MuJoCo, which a list of hands does not need.
        from grasp_refine_apps.report.hand_check import simulation_notes

        notes = simulation_notes(hand)
        self._save([hand_facts(hand) | ({"simulation": notes} if notes else {})])
        console = screen()
        show_hand(hand, console)
        if not hand.contacts_guessed:
            console.print("contact links are named in hand.toml")
        for note in hand.notes:
            console.print(f"note: {note}", markup=False, soft_wrap=True)
        for note in notes:
            console.print(f"in simulation: {note}", markup=False, soft_wrap=True)
        _show_examples(hand, console)
        return 0

    def _check(self, hand: Hand) -> int:
        from grasp_refine_apps.report.hand_check import check_hand
        from grasp_refine_apps.report.hand_toml_text import hand_toml_text

        written = (self.out or hand.urdf.parent) / HAND_TOML if self.write else None
        check_writable(written, overwrite=self.overwrite, inside=self.out)
        found = check_hand(hand)
        if written is not None:
            save_text(written, hand_toml_text(hand, written.parent))
        self._save([hand_facts(hand) | {"check": found.document(), "written": written}])
        console = screen()
        show_hand(hand, console)
        _show_check(hand, found, console)
        _show_examples(hand, console)
        if written is not None:
            used = "its folder, or this URDF," if written.parent == hand.urdf.parent else "its folder"
            message = f"wrote {written}: edit it; it is read when you name {used} as the hand"
        elif hand.toml is not None:
            message = f"{hand.toml} was used"
        else:
            message = f"there is no {HAND_TOML} beside the file; --write writes one to start from"
        console.print(f"\n{message}", markup=False, soft_wrap=True)
        return NOTHING_USABLE if found.refused or not hand.contacts else 0

    def _save(self, facts: list[dict[str, Any]]) -> None:
        save_document(self.json, "hands", {"hands": facts})


def _show_check(hand: Hand, found: HandCheck, console: Console) -> None:
    # These have sections of their own.
    begins = [note for note in hand.notes if note.startswith("the hand begins")]
    notes = [note for note in hand.notes if note not in begins and not note.startswith("contact links guessed")]
    pairs = found.pairs
    overlapping = [f"ignored: {a} and {b}, which overlap in nearly all configurations" for a, b in pairs.nearly_always]
    overlapping += [f"overlap at the rest pose: {a} and {b}; another rest_pose avoids it" for a, b in pairs.at_rest]
    refused = [f"MuJoCo rejects the hand: {found.refused}"] if found.refused else []
    sections = {
        "begins at": [f"link '{hand.base_link}': {hand.base_why}", *begins],
        "meant to touch the object": found.contacts,
        "links that must not run into each other": [
            f"pairs that are checked: {len(pairs.checked)}; neighbours: {pairs.neighbours}; never meet: {pairs.never}",
            *overlapping,
        ],
        "in simulation": [*refused, *found.simulation],
        "to look at": [*notes, *found.suspicious],
    }
    for title, lines in sections.items():
        console.print(f"[bold]{title}[/]")
        console.print(bullets(lines or ["nothing"]))
    if found.jaws:
        console.print(
            "two jaws: {:.1f} to {:.1f} mm wide; sample:N draws antipodal grasps".format(*(1e3 * w for w in found.jaws))
        )
    if found.size:
        console.print("size at rest: {:.0f} x {:.0f} x {:.0f} mm".format(*(side * 1e3 for side in found.size)))


def _show_examples(hand: Hand, console: Console) -> None:
    if found := examples(hand):
        names = ", ".join(path.name for path in found)
        console.print(f"example grasps: {names}", markup=False)
