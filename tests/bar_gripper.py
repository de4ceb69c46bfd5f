"""A parallel gripper as URDFs have them: a tree whose mimic joints keep two bars and a finger a parallelogram."""

from pathlib import Path

from grasp_refine.hands.hand import Hand, load_hand

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
    sides = "".join(_side(name, at, sign, inner_ratio, inner_offset_m) for name, at in (("left", -1), ("right", 1)))
    text = f'<robot name="bars"><link name="palm">{_box("0.09 0.03 0.02", "0 0 -0.02")}</link>{sides}</robot>'
    (folder / "bars.urdf").write_text(text)
    return load_hand(folder / "bars.urdf", candidates=64)


def _side(name: str, at: int, sign: int, inner_ratio: float, inner_offset_m: float) -> str:
    bar = _box(f"0.004 0.004 {BAR_M}", f"0 0 {BAR_M / 2}")
    span = 'lower="0" upper="0.8"' if sign > 0 else 'lower="-0.8" upper="0"'
    back = 'lower="-2" upper="2"'
    lead = "" if name == "left" else '<mimic joint="left_drive"/>'

    def joint(which: str, parent: str, child: str, xyz: str, rpy: str, limits: str, mimic: str) -> str:
        return (
            f'<joint name="{name}_{which}" type="revolute"><parent link="{parent}"/><child link="{name}_{child}"/>'
            f'<origin xyz="{xyz}" rpy="{rpy}"/><axis xyz="0 {-at * sign} 0"/><limit {limits} effort="10" velocity="1"/>'
            f"{mimic}</joint>"
        )

    lean = f"0 {at * OPEN_RAD} 0"
    follow = '<mimic joint="left_drive" multiplier="{}"/>'
    return (
        f'<link name="{name}_outer">{bar}</link><link name="{name}_inner">{bar}</link>'
        f'<link name="{name}_finger">{_box("0.03 0.01 0.006", f"{at * 0.005} 0 0")}</link>'
        f'<link name="{name}_pad">{_box("0.004 0.02 0.03", f"{-at * 0.008} 0 0.02")}</link>'
        + joint("drive", "palm", "outer", f"{at * PIVOT_M} 0 0", lean, span, lead)
        + joint("back", f"{name}_outer", "finger", f"0 0 {BAR_M}", f"0 {-at * OPEN_RAD} 0", back, follow.format(-1))
        + joint(
            "inner_joint",
            "palm",
            "inner",
            f"{at * (PIVOT_M + 0.015)} {inner_offset_m} 0",
            lean,
            back,
            follow.format(inner_ratio),
        )
        + f'<joint name="{name}_fixed" type="fixed"><parent link="{name}_finger"/><child link="{name}_pad"/></joint>'
    )


def _box(size: str, xyz: str) -> str:
    return f'<collision><origin xyz="{xyz}"/><geometry><box size="{size}"/></geometry></collision>'
