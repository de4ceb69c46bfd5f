"""Hands of a specification: loaded, below the base link of the grasps, as they are simulated, and on an arm."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path

from grasp_refine.core.errors import GraspFileError, HandError
from grasp_refine.core.rpy_poses import read_pose
from grasp_refine.grasps.grasp_set import GraspSet
from grasp_refine.grasps.rebase import rebased
from grasp_refine.grasps.renaming import with_prefixes
from grasp_refine.hands.arm_file import load_arm
from grasp_refine.hands.files.description import read_tree
from grasp_refine.hands.files.source import check_known
from grasp_refine.hands.hand import Hand, load_hand
from grasp_refine.hands.mount import mount, standing
from grasp_refine.problem.input_cache import InputCache
from grasp_refine.problem.spec import SourceSpec


@dataclass(frozen=True)
class HandLoader:
    """Loads the hand of a specification."""

    spec: SourceSpec
    """Names and files."""
    cache: InputCache
    """Cache of hands for the next problem."""
    on_message: Callable[[str], None]
    """Called when something is fetched."""

    def load(self, source: str, base_link: str | None) -> Hand:
        """Return a hand, from the files of the specification."""
        spec = self.spec
        options = {name: getattr(spec, name) for name in ("urdf", "mjcf", "collision", "follower_limits", "hull_limit")}

        load = partial(load_hand, source, base_link=base_link, **options, progress=self.on_message)
        return self.cache.get("hand", (source, base_link, *options.values()), load)

    def of_grasps(self, grasps: GraspSet, path: Path) -> tuple[Hand, Hand, GraspSet, list[str]]:
        """Return the hand below the requested base link, it on its arm, the grasps in its frame, and notes.

        Args:
            grasps: The grasps.
            path: Their file.

        Raises:
            GraspRefineError: the hand cannot be loaded, or the grasps are of another one.
        """
        spec = self.spec
        source = spec.hand or grasps.hand
        if spec.hand is None:
            check_known(source, path)
        load = cache(partial(self.load, source))
        if spec.arm is not None or spec.stands:
            # Results begin at the base of the arm.
            whole = self.on_arm(source, self.simulated(load(None if spec.stands else spec.base_link)))
            if grasps.base_link == whole.base_link:
                return whole, whole, grasps, []
        notes = []
        try:
            hand = load(grasps.base_link)
        except HandError:
            full = load(None)
            tree = read_tree(full.urdf)
            if grasps.base_link in tree.links:
                raise
            renamed = with_prefixes(grasps, tree.links, tree.joints)
            if renamed is None:
                raise GraspFileError(
                    f"{path}: the grasps are for another hand ('{grasps.hand}'): their base_link '{grasps.base_link}' "
                    f"is no link of hand '{full.name}'; its links are {', '.join(tree.links)}"
                ) from None
            notes.append(
                f"{path}: base_link '{grasps.base_link}' and the joints of the grasps are found with a prefix, as "
                f"'{renamed.base_link}', in {full.urdf.name}"
            )
            grasps, hand = renamed, load(renamed.base_link)
        if spec.base_link is not None and not spec.stands:
            moved, hand = rebased(grasps, spec.base_link, load), load(spec.base_link)
            resting = [name for name in moved.joint_names if name not in grasps.joint_names]
            notes += [f"joints that the grasps lack begin at rest: {', '.join(resting)}"] if resting else []
            grasps = moved
        if not any(link.body is not None for link in hand.links):
            raise GraspFileError(
                f"{path}: the grasps are for another hand ('{grasps.hand}'): from their base_link "
                f"'{grasps.base_link}' on, no link of hand '{hand.name}' has collision geometry"
            )
        hand = self.simulated(hand)
        return hand, self.on_arm(source, hand), grasps, notes

    def on_arm(self, source: str, hand: Hand) -> Hand:
        """Return a hand on the arm of the specification, or on that of its own file; itself where there is none.

        A file with both is read from the base of the arm on: `base_link`, or the root of the file.

        Args:
            source: The hand, or its file.
            hand: The hand alone.

        Raises:
            GraspRefineError: the arm cannot be loaded, the hand not be mounted, or its file has no arm.
        """
        spec = self.spec
        key = (hand, spec.arm, spec.mount, spec.mount_pose, spec.stands)
        return self.cache.get("whole", key, partial(self._on_arm, source, hand))

    def _on_arm(self, source: str, hand: Hand) -> Hand:
        spec = self.spec
        if hand.arm is not None:
            return hand
        if spec.stands:
            base = spec.base_link or read_tree(hand.urdf).root
            return standing(self.load(source, base), hand.base_link)
        if spec.arm is None:
            return hand
        pose = None if spec.mount_pose is None else read_pose(spec.mount_pose, "`mount_pose`")
        load = partial(load_arm, spec.arm, hull_limit=spec.hull_limit, progress=self.on_message)
        return mount(self.cache.get("hand", (spec.arm, "arm", spec.hull_limit), load), hand, spec.mount, pose)

    def simulated(self, hand: Hand) -> Hand:
        """Return the hand as it will be simulated."""
        # An MJCF of the specification takes precedence.
        hand = hand if self.spec.mjcf is None else replace(hand, collision="mjcf")
        return self.cache.get("simulated", (hand, self.spec.mjcf), partial(with_actuators, hand))


def with_actuators(hand: Hand) -> Hand:
    """Return the hand with the actuators of its MJCF, if that is simulated."""
    if hand.collision != "mjcf" or hand.mjcf is None:
        return hand
    from grasp_refine.validation.engines.mujoco.mjcf_model import mjcf_model

    # Squeezes are set points of these actuators.
    return replace(hand, actuator=mjcf_model(hand, hand.mjcf).actuator)
