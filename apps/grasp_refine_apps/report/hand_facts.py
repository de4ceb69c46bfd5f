"""Facts about a hand, for JSON and for tables."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from grasp_refine.core.errors import GraspFileError
from grasp_refine.grasps.grasp_set import load_grasps
from grasp_refine.hands.files.hand_toml import HAND_TOML
from grasp_refine.hands.files.mimics import followed
from grasp_refine.hands.hand import Hand

_LICENCE = re.compile(r"\b(Apache-2\.0|BSD-[23]-Clause|MIT|GPL-[23]\.0|CC-BY[-A-Z0-9.]*)\b")
_COMMENT = re.compile(r"<!--(.*?)-->", re.DOTALL)


def hand_facts(hand: Hand) -> dict[str, Any]:
    """Return the known facts about a hand, SI units."""
    row = {name: i for i, name in enumerate(hand.joint_names)}
    joints = []
    for joint in hand.joints:
        if not joint.movable:
            continue
        leads = followed(joint, hand.joints_by_name)
        mimic = joint.mimic and {"joint": leads.joint, "multiplier": leads.multiplier, "offset": leads.offset}
        joints.append(
            {
                "name": joint.name,
                "kind": joint.kind,
                "parent": joint.parent,
                "child": joint.child,
                "lower": joint.lower,
                "upper": joint.upper,
                "effort": joint.effort,
                "rest": None if joint.mimic else hand.rest[row[joint.name]],
                "mimics": joint.mimic.joint if joint.mimic else None,
                "follows": mimic,
            }
        )
    return {
        "name": hand.name,
        "urdf": hand.urdf,
        "hand_toml": hand.toml,
        "base_link": hand.base_link,
        "base_link_why": hand.base_why,
        "licence": licence(hand.urdf),
        "joints": joints,
        "links": [
            {"name": link.name, "pieces": len(link.body.pieces) if link.body else 0, "mass_kg": link.mass}
            for link in hand.links
        ],
        "contacts": [
            {"link": contact.link, "group": contact.group, "point": contact.point, "guessed": hand.contacts_guessed}
            for contact in hand.contacts
        ],
        "examples": [path.name for path in examples(hand)],
        "notes": hand.notes,
    }


def facts_without_urdf(name: str) -> dict[str, Any]:
    """Return the few facts about a shipped hand that needs the user's URDF."""
    note = f"its URDF is fetched when it is used, or given with --urdf FILE; {HAND_TOML} has the rest"
    nothing = dict.fromkeys(("urdf", "hand_toml", "base_link", "base_link_why", "licence"))
    lists: dict[str, list[str]] = {"joints": [], "links": [], "contacts": [], "examples": []}
    return {"name": name, **nothing, **lists, "notes": [note]}


def licence(urdf: Path) -> str:
    """Licence named in a comment of the URDF, else the licence file beside it, else ""."""
    comments = " ".join(_COMMENT.findall(urdf.read_text(encoding="utf-8", errors="replace")))
    named = _LICENCE.search(comments)
    if named:
        return named[1]
    beside = sorted(path.name for path in urdf.parent.glob("LICEN[CS]E*"))
    return f"see {beside[0]}" if beside else ""


def examples(hand: Hand) -> list[Path]:
    """Grasp files beside the hand.toml, or beside the URDF where there is none."""
    return sorted(filter(_holds_grasps, (hand.toml or hand.urdf).parent.glob("*.npz")))


def _holds_grasps(path: Path) -> bool:
    try:
        load_grasps(path)
    except GraspFileError:
        return False
    return True
