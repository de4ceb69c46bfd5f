"""Joint order of a hand in formats without joint names, and the frame whose pose they give.

The names are of our hands, and equal the manufacturers' URDFs.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from grasp_refine.core.array_types import Float
from grasp_refine.core.se3 import transform_from_pose
from grasp_refine.grasps.formats.source import Source
from grasp_refine.grasps.grasp_set import GraspSet
from grasp_refine.hands.hand import Hand

IDENTITY_POSE = (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)
"""The identity as a pose, x y z qw qx qy qz."""


@dataclass(frozen=True)
class Layout:
    """Joint order and base frame of one hand in a format."""

    hand: str
    """Our name of the hand."""
    base_link: str
    """Link of its URDF whose pose is that of the hand."""
    joints: tuple[str, ...]
    """Names of the joints in the order of the format."""
    base_pose: tuple[float, ...] = IDENTITY_POSE
    """Pose (7,) of that link in the frame whose pose the format gives; a quaternion of any length."""

    @property
    def T_root_base(self) -> Float[np.ndarray, "4 4"]:
        """`base_pose` as a transform (4, 4)."""
        pose = np.array(self.base_pose)
        pose[3:] /= np.linalg.norm(pose[3:])
        return transform_from_pose(pose)

    def grasps(
        self,
        hand: Hand | None,
        pose: Float[np.ndarray, "N 7"],
        q: Float[np.ndarray, "N n"],
        *,
        object: str | np.ndarray,
        scale: float | np.ndarray = 1.0,
        labels: Mapping[str, np.ndarray] = MappingProxyType({}),
    ) -> GraspSet:
        """Grasps from poses of the base link, and joint values in this order; in that of `hand`, where there is one.

        Object and scale may be one for all.
        """
        return GraspSet(
            hand=hand.name if hand else self.hand,
            base_link=self.base_link,
            joint_names=self.joints,
            object=np.full(len(q), object),
            scale=np.full(len(q), scale),
            hand_pose=pose,
            q=q,
            labels=labels,
        )

    def __str__(self) -> str:
        """Name of the hand and its joints."""
        return f"{self.hand} ({', '.join(self.joints)})"


def _fingers(*fingers: tuple[str, int]) -> tuple[str, ...]:
    """Joints of Shadow fingers, each from the knuckle to the tip."""
    return tuple(f"{finger}J{number}" for finger, count in fingers for number in range(count, 0, -1))


SHADOW_FINGERS = _fingers(("FF", 4), ("MF", 4), ("RF", 4), ("LF", 5))
SHADOW_THUMB = _fingers(("TH", 5))
ALLEGRO = tuple(f"joint_{number}.0" for number in range(16))
LEAP = ("1", "0", "2", "3", "5", "4", "6", "7", "9", "8", "10", "11", "12", "13", "14", "15")

MUJOCO = (
    Layout("shadow", "palm", SHADOW_FINGERS + SHADOW_THUMB, (0.0, 0.0, 0.034, 1.0, 0.0, 0.0, 0.0)),
    Layout("allegro", "base_link", ALLEGRO, (0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 1.0)),
    Layout("leap", "palm_lower", LEAP, (0.0, 0.0, 0.1, 0.0, 1.0, 0.0, 0.0)),
)
"""DexGraspBench and Dexonomy: the order of the MJCF file, and the frame that its <worldbody> holds the palm in.

The offset between the two is what `src/task/convert_format.py` of JYChen18/DexGraspBench subtracts from poses of BODex;
LEAP's is that of MuJoCo Menagerie's first `leap_hand`.
"""

BODEX = (
    Layout("shadow", "palm", SHADOW_THUMB + SHADOW_FINGERS),
    Layout("allegro", "base_link", ALLEGRO),
    Layout("leap", "palm_lower", LEAP),
)
"""BODex: the pose of the palm itself; Shadow with the thumb first (the same source)."""


def layout_of(
    source: Source,
    layouts: Sequence[Layout],
    count: int,
    hand: Hand | None,
    *,
    names: Sequence[str] = (),
    hand_name: str = "",
) -> Layout:
    """The one layout that fits a file, its joints in the order of the file.

    Args:
        source: The file.
        layouts: Layouts of its format.
        count: Number of joint values per grasp.
        hand: The hand that the user gave.
        names: Joint names that the file gives; they then determine the order.
        hand_name: Name of the hand that the file gives.

    Raises:
        GraspFileError: no layout or several fit; shows the joints of the file and of the hand.
    """
    for_hand = [layout for layout in layouts if hand is None or is_of(layout, hand)]
    if names:
        return _by_name(source, for_hand, count, hand, names)
    fitting = [layout for layout in for_hand if len(layout.joints) == count]
    if hand is None and hand_name and fitting:
        said = hand_name.lower()
        fitting = [layout for layout in fitting if layout.hand in said and "left" not in said]
        if not fitting:
            raise source.error(
                f"is for the hand '{hand_name}', and names no joints; known without names are "
                f"{', '.join(map(str, layouts))}; if it is one of these, give it with `hand`"
            )
    if len(fitting) == 1:
        return replace(fitting[0], hand=hand.name) if hand else fitting[0]
    if fitting:
        raise source.error(
            f"has {count} joint values per grasp and no joint names: that fits {' and '.join(map(str, fitting))}; "
            f"choose one with `hand`"
        )
    known = "; ".join(f"{layout.hand} has {len(layout.joints)}: {', '.join(layout.joints)}" for layout in for_hand)
    wanted = f" for hand '{hand.name}' with the joints {', '.join(hand.joint_names)}" if hand else ""
    raise source.error(
        f"has {count} joint values per grasp and no joint names, which fits no order that is known{wanted}; "
        f"{f'known are: {known}' if known else 'give grasps with joint names, such as our own .npz'}"
    )


def check_hand(source: Source, layout: Layout, hand: Hand | None) -> None:
    """Refuse the hand that the user gave for a file of one layout.

    Raises:
        GraspFileError: it lacks the link or a joint of the layout; shows the joints of both.
    """
    if hand is not None and not is_of(layout, hand):
        raise source.error(
            f"is for the hand {layout.hand}, with the joints {', '.join(layout.joints)}; hand '{hand.name}' has "
            f"{', '.join(hand.joint_names)}"
        )


def _by_name(source: Source, layouts: Sequence[Layout], count: int, hand: Hand | None, names: Sequence[str]) -> Layout:
    if len(names) != count or len(set(names)) != count:
        raise source.error(f"has {count} joint values per grasp, but {len(set(names))} joint names: {', '.join(names)}")
    for layout in layouts:
        matched = [_match(name, layout.joints, numbers=hand is not None) for name in names]
        if set(matched) == set(layout.joints):
            return replace(layout, hand=hand.name if hand else layout.hand, joints=tuple(map(str, matched)))
    ours = [f"hand '{hand.name}' has {', '.join(hand.joint_names)}"] if hand else []
    ours += [f"its format knows {layout}" for layout in layouts]
    unknown = [name for name in names if hand and _match(name, hand.joint_names, numbers=True) is None]
    which = f" ({', '.join(unknown)} unknown)" if unknown else ""
    raise source.error(f"names the joints {', '.join(names)}{which}; {'; '.join(ours) or 'no hand here has them'}")


def _match(name: str, wanted: Collection[str], *, numbers: bool) -> str | None:
    """The joint that a name means: itself, or what follows a prefix, as FFJ4 in rh_FFJ4.

    With `numbers` also as 4 in joint_4: many hands number their joints, so that these do not identify the hand.
    """
    if name in wanted:
        return name
    behind = [joint for joint in wanted if numbers or not joint.isdigit()]
    ends = [joint for joint in behind if name.endswith(joint) and not name.removesuffix(joint)[-1].isalnum()]
    return ends[0] if len(ends) == 1 else None


def is_of(layout: Layout, hand: Hand) -> bool:
    """Return True if a hand has the joints and the link of a layout."""
    return set(layout.joints) <= set(hand.joint_names) and layout.base_link in hand.links_by_name
