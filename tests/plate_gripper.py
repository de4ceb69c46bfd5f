"""A parallel gripper as a bare URDF, the smallest hand that grasps."""

from made_hands import link, links, robot, slide, solid

PLATE = solid("box 0.01 0.03 0.06")

PARTS = (
    link("palm", solid("box 0.2 0.03 0.02")),
    links("left", "right", inside=PLATE),
    slide("l", "palm", "left", at="0.09 0 0.05", axis="-1 0 0", limits=(0, 0.07)),
    slide("r", "palm", "right", at="-0.09 0 0.05", axis="-1 0 0", limits=(-0.07, 0)),
)
URDF = robot("gripper", *PARTS)
"""Two plates that slide on a palm, each on its own, from 17 to 3 cm between them."""
