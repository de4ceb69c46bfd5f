"""A parallel gripper as URDFs have them: a tree whose mimic joints keep two bars and a finger a parallelogram."""

from pathlib import Path

from grasp_refine.hands.hand import Hand
from made_hands import joint, link, links, made_hand, solid

BAR_M, PIVOT_M, OPEN_RAD = 0.05, 0.03, 0.5
"""Length of the bars, distance of the outer pivots from the middle, and angle of the bars outwards at joint value 0."""


def bar_gripper(folder: Path, *, sign: int = 1, inner_ratio: float = 1.0, inner_offset_m: float = 0.0) -> Hand:
    """The gripper: along z, closing along x, driven by `drive`.

    Args:
        folder: Where its file is written.
        sign: 1 if rising values close it, -1 if falling ones do.
        inner_ratio: Angle of the inner bars per angle of the outer ones.
        inner_offset_m: Distance of the inner bars from the plane of the others, in metres.
    """
    sides = (_side(name, at, sign, inner_ratio, inner_offset_m) for name, at in (("left", -1), ("right", 1)))
    return made_hand(folder, link("palm", solid("box 0.09 0.03 0.02", "0 0 -0.02")), *sides, name="bars", candidates=64)


def _side(name: str, at: int, sign: int, inner_ratio: float, inner_offset_m: float) -> str:
    bar, span, lean = solid(f"box 0.004 0.004 {BAR_M}", (0, 0, BAR_M / 2)), (0, 0.8), f"0 {at * OPEN_RAD} 0"
    outer, inner, finger, pad = (f"{name}_{part}" for part in ("outer", "inner", "finger", "pad"))
    swing = {"axis": (0, -at * sign, 0), "effort": 10}
    follow = ("left_drive",)
    return "".join((
        links(outer, inner, inside=bar),
        link(finger, solid("box 0.03 0.01 0.006", (at * 0.005, 0, 0))),
        link(pad, solid("box 0.004 0.02 0.03", (-at * 0.008, 0, 0.02))),
        joint(
            f"{name}_drive", "palm", outer, at=(at * PIVOT_M, 0, 0), rpy=lean,
            limits=span if sign > 0 else (-0.8, 0), follow=None if name == "left" else follow, **swing,
        ),
        joint(
            f"{name}_back", outer, finger, at=(0, 0, BAR_M), rpy=(0, -at * OPEN_RAD, 0), limits=(-2, 2),
            follow=(*follow, -1), **swing,
        ),
        joint(
            f"{name}_inner_joint", "palm", inner, at=(at * (PIVOT_M + 0.015), inner_offset_m, 0), rpy=lean,
            limits=(-2, 2), follow=(*follow, inner_ratio), **swing,
        ),
        joint(f"{name}_fixed", finger, pad, "fixed"),
    ))  # fmt: skip
