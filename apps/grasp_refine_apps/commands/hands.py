"""`refine-grasp hands`: hands that ship with the program, what was read of one hand, or trials of several."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from rich.console import Console
from tyro.conf import DisallowNone, Positional, arg

from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.json_files import check_writable, save_text
from grasp_refine.hands.files.hand_toml import HAND_TOML
from grasp_refine.hands.files.link_geometry import HULL_LIMIT
from grasp_refine.hands.hand import Hand, list_hands, load_hand, needs_urdf
from grasp_refine.problem.spec import check_hull_limit
from grasp_refine_apps.commands.options import NOTHING_USABLE, OptionalFile, Overwrite
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

NEEDS_HAND = "without a hand, by its name or URDF: refine-grasp hands HAND"


@dataclass(frozen=True)
class Hands:
    """List the hands that ship with the program, show the joints and links of one, or check your own URDF or MJCF."""

    hands: Annotated[
        Positional[tuple[str, ...]], arg(metavar="[HAND [HAND ...]]", help_behavior_hint="(default: list all)")
    ] = ()
    """Name from the list, folder with a hand.toml or one URDF, or URDF or MJCF file; several with --check --tries."""
    urdf: Annotated[
        DisallowNone[Path | None], arg(metavar="FILE", help_behavior_hint="(default: that of the hand)")
    ] = None
    """URDF of the hand, if it ships without one."""
    mjcf: Annotated[
        DisallowNone[Path | None], arg(metavar="FILE", help_behavior_hint="(default: that of the hand)")
    ] = None
    """Another MJCF file of the same hand, to check that it matches."""
    collision: Annotated[
        DisallowNone[Literal["visual"] | None], arg(metavar="visual", help_behavior_hint="(default: see above)")
    ] = None
    """Geometry with which links of a URDF collide, as for `run`: visual, the geometry that they show. By default their
    collision geometry, or what the hand.toml says."""
    follower_limits: Annotated[
        DisallowNone[Literal["own", "leader"] | None], arg(help_behavior_hint="(default: see above)")
    ] = None
    """Limits of joints that follow others, as for `run`: their own, or leader, the ones that follow from the other
    joint. By default what the hand.toml says, else their own."""
    base_link: Annotated[DisallowNone[str | None], arg(metavar="LINK", help_behavior_hint="(default: see above)")] = (
        None
    )
    """Base link of the hand; with the root of the file, the joints of an arm move, too. By default that of the
    hand.toml, else the palm of a hand on an arm, else the root."""
    hull_limit: float = HULL_LIMIT
    """Largest distance (metres) by which the convex hull of a link's mesh may exceed the mesh, as for `run`."""
    check: Annotated[bool, arg(help_behavior_hint="")] = False
    """Show how the files were read and why, and what looks wrong."""
    tries: Annotated[int, arg(help_behavior_hint="(default: none)")] = 0
    """With --check: number of grasps that are sampled on each of some objects, refined and simulated, instead of the
    other checks; a table has a row for each hand."""
    objects: Annotated[tuple[str, ...], arg(metavar="OBJECT [...]")] = OBJECTS
    """With --tries: the objects, as for `run --object`."""
    protocol: str = "dexgraspbench"
    """With --tries: protocol of the simulation, as for `validate --protocol`."""
    markdown: OptionalFile = None
    """With --tries: write the table to this file."""
    write: Annotated[bool, arg(help_behavior_hint="")] = False
    """With --check: write a hand.toml to start from beside the URDF or MJCF."""
    out: Annotated[DisallowNone[Path | None], arg(metavar="DIR", help_behavior_hint="(default: that of the URDF)")] = (
        None
    )
    """With --write: folder of the hand.toml."""
    seed: int = 0
    """With --tries: random seed of the sampling."""
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
            base_link=self.base_link,
            urdf=self.urdf,
            mjcf=self.mjcf,
            collision=self.collision,
            follower_limits=self.follower_limits,
            candidates=candidates,
            hull_limit=self.hull_limit,
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
        given = {
            "--urdf": self.urdf,
            "--mjcf": self.mjcf,
            "--collision": self.collision,
            "--follower-limits": self.follower_limits,
            "--base-link": self.base_link,
            "--out": self.out,
        }
        named = [option for option, value in given.items() if value is not None]
        named += ["--check"] * self.check + ["--write"] * self.write
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
