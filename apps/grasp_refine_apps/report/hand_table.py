"""Tables of hands: all that come with the program, or joints and links of one."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from grasp_refine.core.plurals import count_text
from grasp_refine.geometry.pieces import Piece
from grasp_refine.hands.files.hand_toml import Contact
from grasp_refine.hands.files.mimics import followed
from grasp_refine.hands.files.tree import Joint
from grasp_refine.hands.hand import Hand
from grasp_refine.results.table import plain_table
from grasp_refine_apps.report.hand_facts import examples, licence

NUMERIC_COLUMNS = ("joints", "links", "lower", "upper", "mass, g", "grasps", "effort")
"""Right-aligned columns."""

UNWRAPPED_COLUMNS = ("hand", "range, deg", "licence", "kind")
"""Columns whose text is never wrapped."""


def list_table(hands: Sequence[Hand], waiting: Sequence[str]) -> Table:
    """Table of the included hands; `waiting` have no URDF."""
    table = _table("hand", "joints", "range, deg", "links", "fingers", "licence", "grasps")
    for hand in hands:
        followers = sum(joint.mimic is not None for joint in hand.joints)
        table.add_row(
            escape(hand.name),
            f"{len(hand.joint_names)}" + (f" + {followers}" if followers else ""),
            _range(hand),
            str(len(hand.links)),
            escape(", ".join(contact.group for contact in hand.contacts)) + " (guessed)" * hand.contacts_guessed,
            escape(licence(hand.urdf)),
            str(len(examples(hand))),
        )
    for name in waiting:
        table.add_row(escape(name), "-", "-", "-", "-", "fetched when used", "-")
    return table


def show_hand(hand: Hand, console: Console) -> None:
    """Print joints and links of a hand."""
    console.print(f"[bold]{escape(hand.name)}[/]  {escape(str(hand.urdf))}", soft_wrap=True)
    followers = sum(joint.mimic is not None for joint in hand.joints)
    solid = sum(link.body is not None for link in hand.links)
    console.print(
        f"{count_text(len(hand.joint_names), 'joint')}"
        f"{f' and {followers} that mimic' if followers else ''}, {len(hand.links)} "
        f"links ({solid} with collision geometry) from {hand.base_link} on, licence: "
        f"{licence(hand.urdf) or 'not named'}\n",
        markup=False,
    )
    console.print(_joints(hand))
    console.print("angles in degrees, slides in millimetres\n", style="dim")
    console.print(_links(hand), "")


def _joints(hand: Hand) -> Table:
    row = {name: i for i, name in enumerate(hand.joint_names)}
    table = _table("joint", "kind", "lower", "upper", "rest, or follows", "effort")
    for joint in hand.joints:
        if not joint.movable:
            continue
        rest = show_value(joint, hand.rest[row[joint.name]]) if joint.mimic is None else _mimic_text(hand, joint)
        effort = "-" if joint.effort is None else f"{joint.effort:g} {'N' if joint.kind == 'prismatic' else 'Nm'}"
        limits = (show_value(joint, joint.lower), show_value(joint, joint.upper))
        table.add_row(*map(escape, (joint.name, joint.kind, *limits, rest, effort)))
    return table


def _mimic_text(hand: Hand, joint: Joint) -> str:
    """Independent joint that a mimic joint follows, such as "-2 x a + 5.0, via b"."""
    leads = followed(joint, hand.joints_by_name)
    if leads.higher:
        return f"on a curve of {leads.joint}"
    text = f"{leads.multiplier:.4g} x {leads.joint}"
    if leads.offset:
        text += f" {'-' if leads.offset < 0 else '+'} {show_value(joint, abs(leads.offset))}"
    assert joint.mimic is not None
    return text if joint.mimic.joint == leads.joint else f"{text}, via {joint.mimic.joint}"


def _links(hand: Hand) -> Table:
    touching = {contact.link for contact in hand.contacts}
    above = {joint.child: joint for joint in hand.joints}
    table = _table("link", "moved by", "convex pieces", "mass, g", "touches as")
    for link in hand.links:
        table.add_row(
            escape(link.name),
            escape(_mover_text(above.get(link.name))),
            _shapes_text(link.body.pieces) if link.body else "none",
            "-" if link.mass is None else f"{link.mass * 1e3:.1f}",
            "; ".join(_contact_text(contact) for contact in hand.contacts if contact.link == link.name),
            style="bold" if link.name in touching else "",
        )
    return table


def _mover_text(joint: Joint | None) -> str:
    """Text for the joint that moves a link; the base link has none."""
    if joint is None:
        return "(base)"
    return joint.name if joint.movable else f"fixed to {joint.parent}"


def bullets(lines: Iterable[str]) -> Table:
    """Lines as a list whose entries stay to the right of their dashes."""
    grid = Table.grid(padding=(0, 1, 0, 0))
    grid.add_column(width=3, justify="right")
    grid.add_column(overflow="fold")
    for line in lines:
        grid.add_row("-", escape(line))
    return grid


def _table(*columns: str) -> Table:
    table = plain_table()
    for column in columns:
        table.add_column(
            column,
            justify="right" if column in NUMERIC_COLUMNS else "left",
            overflow="fold",
            no_wrap=column in UNWRAPPED_COLUMNS,
        )
    return table


def _range(hand: Hand) -> str:
    """Smallest and largest limit of revolute and of prismatic joints, the latter with their unit."""
    texts = []
    for slides in (False, True):
        names = (name for name, sliding in zip(hand.joint_names, hand.slides, strict=True) if sliding == slides)
        alike = [hand.joints_by_name[name] for name in names]
        if alike:
            low, high = min(alike, key=lambda joint: joint.lower), max(alike, key=lambda joint: joint.upper)
            texts.append(f"{show_value(low, low.lower).removesuffix(' mm')} to {show_value(high, high.upper)}")
    return ", ".join(texts) or "-"


def _shapes_text(pieces: Sequence[Piece]) -> str:
    """Summary of convex pieces, such as "3 x hull of 8, sphere"."""
    counts = Counter(len(piece.vertices) for piece in pieces)
    names = {corners: {1: "sphere", 2: "capsule"}.get(corners, f"hull of {corners}") for corners in counts}
    return ", ".join(f"{n} x {names[c]}" if n > 1 else names[c] for c, n in counts.items())


def _contact_text(contact: Contact) -> str:
    point = "" if contact.point is None else " at {:.1f} {:.1f} {:.1f} mm".format(*np.multiply(contact.point, 1e3))
    return escape(("contact" if contact.group == contact.link else contact.group) + point)


def show_value(joint: Joint, value: float) -> str:
    """A value of a joint in degrees or millimetres, the latter with their unit."""
    if joint.kind != "prismatic":
        return _degrees(value)
    return f"{value * 1e3:.1f} mm" if np.isfinite(value) else "free"


def _degrees(radians: float) -> str:
    return f"{np.degrees(radians):.1f}" if np.isfinite(radians) else "free"
