"""Hands: a URDF or MJCF, with a hand.toml or without, as links with bodies, joints with limits, and contact links."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Literal

import numpy as np

from grasp_refine.core.arguments import check_kind
from grasp_refine.core.array_types import Bool, Float
from grasp_refine.core.errors import HandError, MeshError
from grasp_refine.core.names import expand_user
from grasp_refine.core.plurals import count_text, names_text
from grasp_refine.core.short_repr import brief
from grasp_refine.geometry.body import Body, build_body
from grasp_refine.geometry.cache import default_cache
from grasp_refine.hands.arm import Arm
from grasp_refine.hands.files.base_link import guess_base
from grasp_refine.hands.files.defaults import (
    SLIDE_LEVER_M,
    Actuator,
    actuator,
    contacts,
    coupled,
    mjcf_joints,
    rest_pose,
)
from grasp_refine.hands.files.description import read_tree
from grasp_refine.hands.files.fingertips import are_two_fingers
from grasp_refine.hands.files.hand_toml import HAND_TOML, Contact, Coupled
from grasp_refine.hands.files.inertia import Inertia
from grasp_refine.hands.files.link_geometry import HULL_LIMIT, LinkMeshes, link_pieces
from grasp_refine.hands.files.mimics import Curves, curves, limit_by_followers, mimic_map
from grasp_refine.hands.files.mjcf_xml import is_mjcf
from grasp_refine.hands.files.source import hand_files, list_hands, needs_urdf
from grasp_refine.hands.files.tree import Joint, LinkEntry, LinkPair, Mimic, rigid_parts
from grasp_refine.hands.files.visual_collision import with_visual_collision
from grasp_refine.hands.folded_links import folded_links
from grasp_refine.hands.linkages.yielding import YieldingMode

__all__ = ["Actuator", "Contact", "Coupled", "Hand", "Inertia", "Joint", "Link", "Mimic"]
__all__ += ["list_hands", "load_hand", "needs_urdf"]


@dataclass(frozen=True, eq=False)
class Link:
    """A rigid link."""

    name: str
    """Unique name."""
    body: Body | None
    """Collision geometry in the link frame; None if the link has none."""
    mass: float | None
    """Mass in kg; None where the file gives none."""
    inertia: Inertia | None = None
    """Mass, centre and moments as in the file, not necessarily physical; None where it has no moments."""
    solids: tuple[str, ...] = ()
    """The links of its hand that have collision geometry, for messages."""

    __repr__ = brief

    @property
    def solid(self) -> Body:
        """The collision geometry of the link.

        Raises:
            HandError: it has none; names the links that have.
        """
        if self.body is None:
            raise HandError(
                f"link '{self.name}' has no collision geometry; links that have: {', '.join(self.solids) or 'none'}"
            )
        return self.body


@dataclass(frozen=True, eq=False)
class Hand:
    """A robot hand: links with their bodies, joints with their limits, and contact links.

    It is checked: the joints form one tree below `base_link`, and every name in it exists.
    """

    name: str
    """Name in results and in grasp files."""
    urdf: Path
    """The file that it comes from, a URDF or an MJCF."""
    base_link: str
    """The link whose pose is the hand's pose."""
    links: tuple[Link, ...]
    """All links, the base first."""
    joints: tuple[Joint, ...]
    """All joints, fixed ones too, parents before children."""
    joint_names: tuple[str, ...]
    """The n independent joints, which move and mimic no other, in file order."""
    lower: Float[np.ndarray, " n"]
    """Lower limits (n,) in rad or m; -inf if continuous."""
    upper: Float[np.ndarray, " n"]
    """Upper limits (n,) in rad or m; inf if continuous."""
    rest: Float[np.ndarray, " n"]
    """Resting values (n,) in rad or m, within the limits."""
    contacts: tuple[Contact, ...]
    """Links that are meant to touch the object."""
    notes: tuple[str, ...]
    """Remarks for the user on how the files were read."""
    actuator: Actuator
    """Position actuators of the independent joints."""
    modes: tuple[YieldingMode, ...] = ()
    """Modes in which linkages yield to a push, against springs."""
    compliance: Float[np.ndarray, " n"] | None = None
    """Compliance (n,) of linkages between actuators and fingertips, in rad per N m or m per N; None: there are none."""
    coupled: tuple[Coupled, ...] = ()
    """Groups of independent joints that share an actuator."""
    excluded: tuple[LinkPair, ...] | None = None
    """Pairs of links that never collide, by an MJCF; None: a URDF has none."""
    mjcf: Path | None = None
    """MJCF file of the same hand, where there is one; `urdf`, where that is an MJCF and no other is given."""
    mjcf_joints: Mapping[str, str] = field(default_factory=dict)
    """Joint -> its name in that file, where hand.toml gives it."""
    collision: Literal["urdf", "mjcf", "visual"] = "urdf"
    """File that is simulated when a grasp is validated; "visual": the URDF, whose links collide as they look."""
    follower_limits: Literal["own", "leader"] = "own"
    """Limits of mimic joints: their own, or the ones that follow from the joint that they follow."""
    patches: bool = False
    """Whether flat faces of its links touch flat faces of objects in patches, not in points."""
    toml: Path | None = None
    """The hand.toml that was read; None where there was none."""
    contacts_guessed: bool = False
    """Whether the contact links are the program's choice, because no hand.toml names any."""
    base_why: str = ""
    """Reason for the choice of the base link, for people."""
    mount: str | None = None
    """Link of an arm that hands are mounted on where none is given."""
    T_base_flange: Float[np.ndarray, "4 4"] | None = None
    """Pose (4, 4) of the flange of an arm that carries it in the frame of `base_link`; None: that frame, or a hand that
    begins at another link than hand.toml says."""
    arm: Arm | None = None
    """Arm that carries the palm from a base that stands still; None: the base is the palm, and moves freely."""
    parts: tuple[Hand, ...] = ()
    """The arm and the hand it was made from, with the names of the whole; none where one file has all."""

    def __repr__(self) -> str:
        parts = (len(self.joint_names), "joint"), (len(self.links), "link"), (len(self.contacts), "contact point")
        return f"Hand({self.name}: {', '.join(count_text(*part) for part in parts)})"

    @cached_property
    def links_by_name(self) -> dict[str, Link]:
        """Links by name."""
        return {link.name: link for link in self.links}

    @cached_property
    def joints_by_name(self) -> dict[str, Joint]:
        """Joints by name."""
        return {joint.name: joint for joint in self.joints}

    @cached_property
    def fingers(self) -> tuple[str, ...]:
        """Names of the fingers: the groups of the contact links."""
        return tuple(dict.fromkeys(contact.group for contact in self.contacts))

    @property
    def has_two_fingers(self) -> bool:
        """True for a hand with two fingers, which press against each other, as in grippers."""
        return are_two_fingers(self.contacts)

    @property
    def palm(self) -> str:
        """The link of the palm: the base link, or the hand's base on an arm."""
        return self.base_link if self.arm is None else self.arm.palm

    @property
    def arm_joints(self) -> Bool[np.ndarray, " n"]:
        """True (n,) for independent joints of the arm; none without an arm."""
        return np.zeros(len(self.joint_names), dtype=bool) if self.arm is None else self.arm.joints

    @cached_property
    def slides(self) -> Bool[np.ndarray, " n"]:
        """True (n,) for independent joints that slide, whose values are in metres; the others turn."""
        return np.array([self.joints_by_name[name].kind == "prismatic" for name in self.joint_names], dtype=bool)

    @cached_property
    def per_radian(self) -> Float[np.ndarray, " n"]:
        """Movement (n,) of each independent joint that counts as one radian: 1 rad, or `SLIDE_LEVER_M` of a slide.

        What has one number for all joints, such as noise and bounds, has it in radians and is multiplied by these.
        """
        return np.where(self.slides, SLIDE_LEVER_M, 1.0)

    @cached_property
    def parts_of_links(self) -> dict[str, str]:
        """Link -> the link by which its rigid part is known: links of a part do not move against each other."""
        return {self.base_link: self.base_link} | rigid_parts(self.joints)

    @cached_property
    def stiffness(self) -> Float[np.ndarray, " n"]:
        """Stiffness (n,) of each actuator at the fingertips, in N m per rad or N per m."""
        kp = np.maximum(self.actuator.kp, 0.0)
        return kp if self.compliance is None else kp / (1.0 + kp * self.compliance)

    @cached_property
    def yielding(self) -> frozenset[str]:
        """Links of linkages that yield to a push; only links in `contacts` may hold an object."""
        return frozenset(link for mode in self.modes for link in mode.twists)

    def fixed_to(self, link: str) -> frozenset[str]:
        """Return the names of a link and of the links below it that are fixed to it."""
        fixed = {link}
        for joint in self.joints:  # parents before children
            fixed |= {joint.child} if joint.parent in fixed and not joint.movable else set()
        return frozenset(fixed)

    def joints_to(self, links: Sequence[str]) -> list[Joint]:
        """Return the joints between the base link and any of `links`, parents before children.

        Raises:
            HandError: the hand has no link of such a name.
        """
        unknown = [link for link in links if link not in self.links_by_name]
        if unknown:
            known = ", ".join(sorted(self.links_by_name))
            raise HandError(f"hand {self.name} has no link {', '.join(unknown)}; it has {known}")
        wanted, above = set(links), []
        for joint in reversed(self.joints):
            if joint.child in wanted:
                wanted.add(joint.parent)
                above.append(joint)
        return above[::-1]

    def mimic_map(self) -> tuple[Float[np.ndarray, "m n"], Float[np.ndarray, " m"], tuple[str, ...]]:
        """Matrix (m, n), offset (m,) and names (m,) that give the values of all m movable joints.

        values = matrix @ q + offset, for q in the order of `joint_names` and names in the order of `joints`, plus
        `curves`(q) where couplings are not linear.
        """
        return mimic_map(self.joints, self.joint_names)

    @cached_property
    def curves(self) -> Curves:
        """Nonlinear parts of the values of all movable joints, as in linkages."""
        return curves(self.joints, self.joint_names)


def load_hand(
    source: str | Path,
    *,
    base_link: str | None = None,
    urdf: str | Path | None = None,
    mjcf: str | Path | None = None,
    collision: Literal["visual"] | None = None,
    follower_limits: Literal["own", "leader"] | None = None,
    candidates: int = 1024,
    hull_limit: float = HULL_LIMIT,
    progress: Callable[[str], None] | None = None,
) -> Hand:
    """The hand that `source` names.

    It is one of `list_hands()`, a folder, a URDF or MJCF file, a hand.toml, an asset, or robot_descriptions/NAME, which
    needs the extra of that name.

    A folder holds a hand.toml, or exactly one .urdf file, or none and exactly one MJCF. The hand.toml beside a
    URDF or MJCF is used if it names that file. An MJCF is read as MuJoCo compiles it, with its couplings and actuators,
    and is simulated.

    Args:
        source: Name or path; a hand of ours wins over a folder of the same name, which is ./NAME.
        base_link: The hand is the tree below this link; by default hand.toml's base_link, else `guess_base`'s: the
            palm of a hand on an arm, otherwise the root.
        urdf: Used instead of the URDF that hand.toml names; hands that come without a URDF have theirs fetched.
        mjcf: Used instead of the MJCF that hand.toml names; a file, or an asset. Joints that share an actuator
            there do so in the hand, and joints that follow others are mimic joints, unless hand.toml overrides it.
        collision: "visual": links of a URDF collide as they look, for hands without collision geometry; None: as in
            hand.toml, else their collision geometry.
        follower_limits: Limits of mimic joints: "own", or "leader": what follows from the joint that they follow, for
            files whose mimic signs contradict the limits; None: as in hand.toml, else "own".
        candidates: Surface points per link.
        hull_limit: Greatest distance in metres by which the hull of a mesh may stand out of it; beyond, more pieces are
            used, which the user's cache folder keeps; infinite: only hulls.
        progress: Called with one line when something is fetched, and when a mesh is cut.

    Raises:
        AssetError: no such name, or an asset that cannot be fetched.
        HandError: a file is missing or malformed, or names something that does not exist.
        GraspRefineError: an argument of another kind.
    """
    check_kind("source", source, str | Path)
    check_kind("base_link", base_link, str | None)
    check_kind("urdf", urdf, str | Path | None)
    check_kind("mjcf", mjcf, str | Path | None)
    check_kind("collision", collision, str | None)
    check_kind("follower_limits", follower_limits, str | None)
    check_kind("candidates", candidates, int)
    check_kind("hull_limit", hull_limit, float)
    if collision not in (None, "visual"):
        raise HandError(f"collision must be 'visual' or None, got {collision!r}")
    if follower_limits not in (None, "own", "leader"):
        raise HandError(f"follower_limits must be 'own', 'leader' or None, got {follower_limits!r}")
    if hull_limit < 0:
        raise HandError(f"hull_limit must be at least 0 m, got {hull_limit:g}")
    name, toml = hand_files(
        source,
        None if urdf is None else expand_user(Path(urdf)),
        None if mjcf is None else Path(mjcf),
        progress or (lambda line: None),
    )
    assert toml.file is not None  # `hand_files` gives one
    from_mjcf = is_mjcf(toml.file)
    mjcf_file, geometry = toml.mjcf, collision or toml.collision
    if from_mjcf and geometry != "visual":
        mjcf_file, geometry = toml.mjcf or toml.file, "mjcf"
    if geometry == "mjcf" and mjcf_file is None:
        raise HandError(f"{toml.path}: collision = 'mjcf' needs mjcf = \"FILE\", or `mjcf=FILE`")
    tree = read_tree(toml.file)
    if geometry == "visual":
        tree = with_visual_collision(tree)
    notes = list(tree.notes)
    base, why = (base_link, "given by `base_link`") if base_link else (toml.base_link, f"given by {HAND_TOML}")
    if base is None:
        guess = guess_base(tree)
        base, why = guess.link, guess.why
        if guess.above:
            notes.append(
                f"the hand begins at its palm, link '{base}': the joints above it do not move "
                f"({', '.join(guess.above)}); `base_link='{tree.root}'` moves them too"
            )
        if guess.others:
            notes.append(
                f"the hand begins at link '{base}', and several moving branches leave {', '.join(guess.others)}, too: "
                "if one of these is the palm, give it with `base_link`"
            )
    raw_links, joints = tree.below(base)
    outside = tree.joints.keys() - {joint.name for joint in joints}
    names_there = mjcf_joints(toml, [joint.name for joint in joints if joint.movable], outside)
    couplings = None
    if mjcf_file is not None:
        # These load MuJoCo, which reading a URDF does without.
        from grasp_refine.hands.files.alignment import Mechanism
        from grasp_refine.hands.linkages.mjcf_couplings import mjcf_couplings

        # The hand's own file counts, even where another MJCF is simulated.
        theirs, named = (tree.path, {}) if from_mjcf else (mjcf_file, names_there)
        couplings = mjcf_couplings(theirs, Mechanism.of(toml.name or name, base, tree, joints), named)
    if couplings is not None:
        joints, tied = couplings.with_mimics(joints, toml.joints_with_settings)
        notes += [*couplings.notes, *tied]
    follower_limits = follower_limits or toml.follower_limits
    joints, narrowed = limit_by_followers(joints, tree.path, follower_limits)
    meshes = LinkMeshes(tree.path, hull_limit, default_cache(), progress or (lambda line: None))
    meshes.require(raw_links)
    links = tuple(_link(raw, meshes, candidates) for raw in raw_links)
    solids = tuple(link.name for link in links if link.body is not None)
    links = tuple(replace(link, solids=solids) for link in links)
    moving = {joint.name: joint for joint in joints if joint.movable and joint.mimic is None}
    independent = [moving[joint] for joint in tree.joints if joint in moving]
    groups = coupled(toml, independent, outside)
    if couplings is not None:
        groups, shared = couplings.with_tendons(groups, joints)
        notes += shared
    driven = actuator(toml, independent, outside)
    if from_mjcf:
        from grasp_refine.hands.linkages.servos import own_actuator

        driven = own_actuator(Mechanism.of(toml.name or name, base, tree, joints), groups, driven)
    closing = () if couplings is None else couplings.ends
    if not toml.contacts and not closing and any(joint.mimic is not None for joint in joints):
        # This loads the collision queries, which most hands do without.
        from grasp_refine.hands.linkages.pins import pinned_links

        bodies = {link.name: link.body for link in links if link.body is not None}
        closing = pinned_links(base, joints, [joint.name for joint in independent], bodies)
    folded: dict[str, str] = {}
    if not toml.contacts:
        bodies = {link.name: link.body for link in links if link.body is not None}
        folded = folded_links(base, joints, [joint.name for joint in independent], bodies)
    left_out = tree.links.keys() - {link.name for link in links}
    touching, guessed, about_contacts = contacts(toml, solids, joints, left_out, closing, folded)
    notes += [*about_contacts, *narrowed, *meshes.notes()]
    still = [joint.name for joint in independent if joint.lower == joint.upper]
    notes += [f"no movement by joints with equal limits: {names_text(still)}"] * bool(still)
    modes: tuple[YieldingMode, ...] = ()
    compliance = None
    if from_mjcf and couplings is not None:  # a URDF may have other frames than the bodies of an MJCF
        modes, compliance = couplings.yielding(independent, touching)
    return Hand(
        name=toml.name or name,
        urdf=tree.path,
        base_link=base,
        links=links,
        joints=tuple(joints),
        joint_names=tuple(joint.name for joint in independent),
        lower=np.array([joint.lower for joint in independent]),
        upper=np.array([joint.upper for joint in independent]),
        rest=rest_pose(toml, independent, outside),
        contacts=touching,
        contacts_guessed=guessed,
        notes=tuple(notes),
        actuator=driven,
        modes=modes,
        compliance=compliance,
        coupled=groups,
        excluded=tuple(pair for pair in tree.excluded if {*pair} <= {*solids}) if from_mjcf else None,
        mjcf=mjcf_file,
        mjcf_joints=names_there,
        collision=geometry,
        follower_limits=follower_limits,
        patches=are_two_fingers(touching) if toml.patches is None else toml.patches,
        toml=None if toml.path == toml.file else toml.path,
        base_why=why,
        mount=toml.mount,
        T_base_flange=toml.T_base_flange if base == toml.base_link else None,
    )


def _link(raw: LinkEntry, meshes: LinkMeshes, candidates: int) -> Link:
    pieces = link_pieces(raw, meshes)
    if raw.mass is not None and raw.mass < 0:
        raise HandError(f"{meshes.path}: link '{raw.name}' has the mass {raw.mass:g} kg")
    try:
        body = build_body(raw.name, pieces, candidates=candidates) if pieces else None
    except MeshError as error:
        raise HandError(f"{meshes.path}: link {error}") from None
    return Link(raw.name, body, raw.mass, raw.inertia)
