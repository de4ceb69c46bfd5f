"""`refine-grasp hands`: the hands that come with the program, or everything that was read of one hand."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from rich import box
from rich.console import Console
from rich.markup import escape
from rich.table import Table
from tyro.conf import DisallowNone, Positional, arg

from grasp_refine.errors import GraspRefineError
from grasp_refine.geometry.pieces import Piece
from grasp_refine.hand import HAND_TOML, Contact, Hand, list_hands, load_hand, needs_urdf
from grasp_refine.report.screen import screen
from grasp_refine.report.writing import SCHEMA, check_writable, save_json
from grasp_refine.versions import versions

CANDIDATES = 16
"""Surface points per link; nothing here looks at them."""

_LICENCE = re.compile(r"\b(Apache-2\.0|BSD-[23]-Clause|MIT|GPL-[23]\.0|CC-BY[-A-Z0-9.]*)\b")
_COMMENT = re.compile(r"<!--(.*?)-->", re.DOTALL)


@dataclass(frozen=True)
class Hands:
    """List the hands that come with the program, or show what is read of one hand."""

    hand: Annotated[
        Positional[DisallowNone[str | None]], arg(metavar="[HAND]", help_behavior_hint="(default: list all)")
    ] = None
    """A name from the list, a folder with a hand.toml or one URDF, or a .urdf file."""
    urdf: Annotated[DisallowNone[Path | None], arg(metavar="FILE", help_behavior_hint="(default: as named)")] = None
    """The hand's URDF, where it comes without one."""
    mjcf: Annotated[DisallowNone[Path | None], arg(metavar="FILE", help_behavior_hint="(default: as named)")] = None
    """The same hand as an MJCF file, to see whether they match."""
    json: Annotated[DisallowNone[Path | None], arg(metavar="FILE", help_behavior_hint="(default: none)")] = None
    """Write what is known about the hands to this file."""

    def execute(self) -> int:
        """Do it; returns the exit code.

        Raises:
            GraspRefineError: no such hand, or one that cannot be read.
        """
        if self.json is not None:
            check_writable(self.json)
        if self.hand is None and (self.urdf is not None or self.mjcf is not None):
            raise GraspRefineError("--urdf and --mjcf need the name of a hand: refine-grasp hands NAME --urdf FILE")
        if self.hand is None:
            waiting = [name for name in list_hands() if needs_urdf(name)]
            hands = [load_hand(name, candidates=CANDIDATES) for name in list_hands() if name not in waiting]
        else:
            waiting = []
            hands = [load_hand(self.hand, urdf=self.urdf, mjcf=self.mjcf, candidates=CANDIDATES)]
        simulated = () if self.hand is None else _simulated(hands[0])
        if self.json is not None:
            facts = [hand_facts(hand) | ({"simulation": simulated} if simulated else {}) for hand in hands]
            facts += [_facts_without_urdf(name) for name in waiting]
            save_json(self.json, {"schema": SCHEMA, "command": "hands", "versions": versions(), "hands": facts})
        console = screen()
        if self.hand is None:
            _list(hands, waiting, console)
        else:
            _details(hands[0], simulated, console)
        return 0


def _simulated(hand: Hand) -> tuple[str, ...]:
    """What there is to know of how the hand is simulated.

    Raises:
        HandError: its MJCF cannot be used.
    """
    # These load torch and MuJoCo, which a list of hands does not need.
    from grasp_refine.validation.mjcf_model import mjcf_model
    from grasp_refine.validation.urdf_model import urdf_model

    if hand.mjcf is None:
        return urdf_model(hand).notes
    model = mjcf_model(hand, hand.mjcf)
    matched = f"{hand.mjcf.name} moves like the URDF: {len(model.joints)} joints matched by name and place"
    return (matched, *model.notes)


def hand_facts(hand: Hand) -> dict[str, Any]:
    """What is known about a hand, for JSON; SI units."""
    row = {name: i for i, name in enumerate(hand.joint_names)}
    return {
        "name": hand.name,
        "urdf": hand.urdf,
        "base_link": hand.base_link,
        "licence": licence(hand.urdf),
        "joints": [
            {
                "name": joint.name,
                "kind": joint.kind,
                "parent": joint.parent,
                "child": joint.child,
                "lower": joint.lower,
                "upper": joint.upper,
                "rest": hand.rest[row[joint.name]] if joint.name in row else None,
                "mimics": joint.mimic.joint if joint.mimic else None,
            }
            for joint in hand.joints
            if joint.movable
        ],
        "links": [
            {"name": link.name, "pieces": len(link.body.pieces) if link.body else 0, "mass_kg": link.mass}
            for link in hand.links
        ],
        "contacts": [
            {"link": contact.link, "group": contact.group, "point": contact.point, "guessed": _guessed(hand)}
            for contact in hand.contacts
        ],
        "examples": [path.name for path in _examples(hand)],
        "notes": hand.notes,
    }


def _facts_without_urdf(name: str) -> dict[str, Any]:
    """The same of a hand of ours that needs the user's URDF: little."""
    note = f"needs a URDF: --urdf FILE; {HAND_TOML} says the rest"
    nothing = dict.fromkeys(("urdf", "base_link", "licence"))
    lists: dict[str, list[str]] = {"joints": [], "links": [], "contacts": [], "examples": []}
    return {"name": name, **nothing, **lists, "notes": [note]}


def licence(urdf: Path) -> str:
    """The licence that a comment in the URDF names, else the licence file beside it, else ""."""
    comments = " ".join(_COMMENT.findall(urdf.read_text(encoding="utf-8", errors="replace")))
    named = _LICENCE.search(comments)
    if named:
        return named[1]
    beside = sorted(path.name for path in urdf.parent.glob("LICEN[CS]E*"))
    return f"see {beside[0]}" if beside else ""


def _guessed(hand: Hand) -> bool:
    """Whether the contact links are the program's choice: then a note of the hand says so."""
    return any(note.startswith("contact links guessed") for note in hand.notes)


def _examples(hand: Hand) -> list[Path]:
    """Grasp files beside the URDF."""
    return sorted(hand.urdf.parent.glob("*.npz"))


def _list(hands: list[Hand], waiting: list[str], console: Console) -> None:
    table = _table("hand", "joints", "range, deg", "links", "solid", "contacts", "licence", "examples")
    for hand in hands:
        table.add_row(
            escape(hand.name),
            str(len(hand.joint_names)),
            _range(hand),
            str(len(hand.links)),
            str(_solid(hand)),
            f"{len(hand.contacts)}{' (guessed)' if _guessed(hand) else ''}",
            escape(licence(hand.urdf)),
            str(len(_examples(hand))),
        )
    for name in waiting:
        table.add_row(escape(name), *["-"] * 5, "needs --urdf", "-")
    console.print(table)
    for hand in hands:
        for note in hand.notes:
            console.print(f"{hand.name}: {note}", markup=False)
    console.print("\nrefine-grasp hands NAME shows its joints, links and contact links; a URDF file works too.")


def _details(hand: Hand, simulated: tuple[str, ...], console: Console) -> None:
    console.print(f"[bold]{escape(hand.name)}[/]  {escape(str(hand.urdf))}", soft_wrap=True)
    console.print(
        f"{len(hand.joint_names)} joints, {len(hand.links)} links ({_solid(hand)} with geometry) from "
        f"{hand.base_link} on, licence: {licence(hand.urdf) or 'not named'}\n",
        markup=False,
    )
    row = {name: i for i, name in enumerate(hand.joint_names)}
    joints = _table("joint", "kind", "lower", "upper", "rest", "moves link")
    for joint in hand.joints:
        if not joint.movable:
            continue
        show = _millimetres if joint.kind == "prismatic" else _degrees
        if joint.mimic is None:
            rest = show(hand.rest[row[joint.name]])
        else:
            mimic = joint.mimic
            rest = f"{mimic.multiplier:g} x {mimic.joint}" + (f" + {show(mimic.offset)}" if mimic.offset else "")
        cells = (joint.name, joint.kind, show(joint.lower), show(joint.upper), rest, joint.child)
        joints.add_row(*map(escape, cells))
    console.print(joints, "")
    touching = {contact.link for contact in hand.contacts}
    links = _table("link", "convex pieces", "mass, g", "touches")
    for link in hand.links:
        links.add_row(
            escape(link.name),
            _shapes(link.body.pieces) if link.body else "none",
            "-" if link.mass is None else f"{link.mass * 1e3:.1f}",
            "; ".join(_where(contact) for contact in hand.contacts if contact.link == link.name),
            style="bold" if link.name in touching else "",
        )
    console.print(links, "")
    if not _guessed(hand):
        console.print("contact links are those that hand.toml names")
    for note in hand.notes:
        console.print(f"note: {note}", markup=False)
    for note in simulated:
        console.print(f"in simulation: {note}", markup=False)
    if _examples(hand):
        names = ", ".join(path.name for path in _examples(hand))
        console.print(f"example grasps: {names}", markup=False)


def _table(*columns: str) -> Table:
    table = Table(box=box.SIMPLE_HEAD, show_edge=False, padding=(0, 1, 0, 0), header_style="dim")
    for column in columns:
        left = column in (
            "hand",
            "joint",
            "link",
            "kind",
            "rest",
            "moves link",
            "convex pieces",
            "touches",
            "licence",
        )
        whole = column in ("hand", "range, deg", "licence")
        table.add_column(column, justify="left" if left else "right", overflow="fold", no_wrap=whole)
    return table


def _range(hand: Hand) -> str:
    """Smallest and largest limit of the turning joints."""
    turning = [joint for joint in hand.joints if joint.name in hand.joint_names and joint.kind != "prismatic"]
    if not turning:
        return "-"
    return f"{_degrees(min(j.lower for j in turning))} to {_degrees(max(j.upper for j in turning))}"


def _solid(hand: Hand) -> int:
    return sum(link.body is not None for link in hand.links)


def _shapes(pieces: Sequence[Piece]) -> str:
    """What convex pieces are, such as "3 x hull of 8, ball"."""
    counts = Counter(len(piece.vertices) for piece in pieces)
    names = {corners: {1: "ball", 2: "capsule"}.get(corners, f"hull of {corners}") for corners in counts}
    return ", ".join(f"{n} x {names[c]}" if n > 1 else names[c] for c, n in counts.items())


def _where(contact: Contact) -> str:
    point = "" if contact.point is None else " at {:.1f} {:.1f} {:.1f} mm".format(*np.multiply(contact.point, 1e3))
    return escape(("contact" if contact.group == contact.link else contact.group) + point)


def _degrees(radians: float) -> str:
    return f"{np.degrees(radians):.1f}" if np.isfinite(radians) else "free"


def _millimetres(metres: float) -> str:
    return f"{metres * 1e3:.1f} mm" if np.isfinite(metres) else "free"
