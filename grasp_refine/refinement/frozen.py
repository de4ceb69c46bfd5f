"""Parts of a hand that a refinement keeps where they are: its palm, fingers and joints."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from grasp_refine.core.array_types import Bool, Float
from grasp_refine.core.errors import HandError, did_you_mean
from grasp_refine.hands.chain import Chain
from grasp_refine.hands.hand import Hand

PALM, TRANSLATION, ROTATION = "palm", "translation", "rotation"


@dataclass(frozen=True, eq=False)
class Frozen:
    """Unknowns of a refinement that keep their initial values to the last bit."""

    unknowns: Bool[np.ndarray, " k"]
    """True (6 + n,) for frozen components of a step: translation and rotation of the base link, and joint values."""

    @classmethod
    def of(cls, hand: Hand, names: tuple[str, ...]) -> Frozen:
        """Return the unknowns that move parts of a hand.

        Names are, in this order:

        - "palm": pose of the base link, and joints of an arm or a wrist, which carry all fingers;
        - "translation" or "rotation": that of the base link, of a hand without an arm;
        - an independent joint; joints that mimic it stay with it;
        - a finger (`Hand.fingers`): the joints that move its contact links, and no other finger.

        Raises:
            HandError: a name is none of these, a finger has no joint of its own, or the palm of a hand on an arm is to
                keep its translation or its rotation alone.
        """
        found = np.zeros(6 + len(hand.joint_names), dtype=bool)
        if not names:
            return cls(found)
        fingers, carriers = _joints(hand)
        single = np.sum([*fingers.values()], axis=0) == 1
        known = (PALM, TRANSLATION, ROTATION, *hand.joint_names, *hand.fingers)
        for name in names:
            if name == PALM:
                found[:6] = True
                found[6:] |= carriers
            elif name in (TRANSLATION, ROTATION):
                if hand.arm is not None:
                    raise HandError(f"`freeze`: the arm of {hand.name} moves its palm as a whole: palm, not {name}")
                found[slice(3) if name == TRANSLATION else slice(3, 6)] = True
            elif name in hand.joint_names:
                found[6 + hand.joint_names.index(name)] = True
            elif name in hand.fingers:
                own = fingers[name] & single & ~carriers
                if not own.any():
                    shared = ", ".join(np.array(hand.joint_names)[fingers[name] & ~carriers]) or "no joint"
                    raise HandError(
                        f"`freeze`: finger {name} of hand {hand.name} has no joint of its own; {shared} moves it with "
                        "others"
                    )
                found[6:] |= own
            else:
                raise HandError(
                    f"`freeze`: hand {hand.name} has no {name}{did_you_mean(name, known)} there are {PALM}, "
                    f"{TRANSLATION}, {ROTATION}, its fingers {', '.join(hand.fingers)}, and its joints "
                    f"{', '.join(hand.joint_names)}"
                )
        return cls(found)

    @property
    def joints(self) -> Bool[np.ndarray, " n"]:
        """True (n,) for frozen joints."""
        return self.unknowns[6:]

    def restore(
        self,
        T: Float[np.ndarray, "M 4 4"],
        q: Float[np.ndarray, "M n"],
        T_first: Float[np.ndarray, "M 4 4"],
        q_first: Float[np.ndarray, "M n"],
    ) -> tuple[Float[np.ndarray, "M 4 4"], Float[np.ndarray, "M n"]]:
        """Return poses of the base link and joint values with their frozen parts taken from the first ones."""
        fixed = np.zeros((4, 4), dtype=bool)
        fixed[:3, 3], fixed[:3, :3] = self.unknowns[0], self.unknowns[3]
        return np.where(fixed, T_first, T), np.where(self.joints, q_first, q)


def _joints(hand: Hand) -> tuple[dict[str, Bool[np.ndarray, " n"]], Bool[np.ndarray, " n"]]:
    """Return the independent joints (n,) that move each finger, and those of an arm or wrist, which carry them all."""
    chain = Chain(hand, [contact.link for contact in hand.contacts])
    group = np.array([contact.group for contact in hand.contacts])
    fingers = {finger: chain.moves[group == finger].any(axis=0) for finger in hand.fingers}
    # Jaws that move together have a joint each: none carries both.
    above = chain.joint_mask(np.arange(len(hand.contacts)))[:, 6:] > 0
    carries = above.all(axis=0) & (len(hand.fingers) > 1)
    return fingers, (carries @ (chain.joint_gains != 0)) | hand.arm_joints
