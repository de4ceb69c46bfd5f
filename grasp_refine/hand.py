"""Hands: a URDF, with a hand.toml or without, as links with bodies, joints with limits, and contact links."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np
from jaxtyping import Float

from grasp_refine.assets import resource_dir
from grasp_refine.description.defaults import Actuator, actuator, contacts, coupled, mjcf_joints, rest_pose
from grasp_refine.description.hand_toml import Contact, Coupled, HandToml, only_urdf, read_hand_toml
from grasp_refine.description.inertia import Inertia
from grasp_refine.description.link_geometry import link_pieces
from grasp_refine.description.tree import Joint, Mimic, read_tree
from grasp_refine.errors import AssetError, HandError, MeshError
from grasp_refine.geometry.body import Body, build_body
from grasp_refine.geometry.pieces import Piece

if TYPE_CHECKING:
    import yourdfpy

__all__ = ["Actuator", "Contact", "Coupled", "Hand", "Inertia", "Joint", "Link", "Mimic"]
__all__ += ["list_hands", "load_hand", "needs_urdf"]

HAND_TOML = "hand.toml"
"""Name of the file beside a URDF that says what the URDF does not."""


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
    """Mass, centre and moments as the file gives them, which need not be possible; None where it has no moments."""


@dataclass(frozen=True, eq=False)
class Hand:
    """A hand, checked: its joints are one tree below `base_link`, and every name in it means something."""

    name: str
    """Name in results and in grasp files."""
    urdf: Path
    """The file that it comes from."""
    base_link: str
    """The link whose pose is the hand's pose."""
    links: tuple[Link, ...]
    """All links, the base first."""
    joints: tuple[Joint, ...]
    """All joints, fixed ones too, parents before children."""
    joint_names: tuple[str, ...]
    """The n independent joints: those that move and mimic no other, in file order."""
    lower: Float[np.ndarray, " n"]
    """Lower limits (n,) in rad or m; -inf if continuous."""
    upper: Float[np.ndarray, " n"]
    """Upper limits (n,) in rad or m; inf if continuous."""
    rest: Float[np.ndarray, " n"]
    """Resting values (n,) in rad or m, within the limits."""
    contacts: tuple[Contact, ...]
    """Links that are meant to touch the object."""
    notes: tuple[str, ...]
    """What a user should know about how the files were read."""
    actuator: Actuator
    """How the independent joints are driven."""
    coupled: tuple[Coupled, ...] = ()
    """Groups of independent joints that share an actuator."""
    mjcf: Path | None = None
    """The same hand as an MJCF file, where there is one."""
    mjcf_joints: Mapping[str, str] = field(default_factory=dict)
    """Joint -> its name in that file, where hand.toml says it."""
    collision: Literal["urdf", "mjcf"] = "urdf"
    """Which of the two files is simulated when a grasp is validated."""

    @cached_property
    def links_by_name(self) -> dict[str, Link]:
        """Links by name."""
        return {link.name: link for link in self.links}

    @cached_property
    def joints_by_name(self) -> dict[str, Joint]:
        """Joints by name."""
        return {joint.name: joint for joint in self.joints}

    def mimic_map(self) -> tuple[Float[np.ndarray, "m n"], Float[np.ndarray, " m"], tuple[str, ...]]:
        """Matrix (m, n), offset (m,) and names (m,) that give the values of all m movable joints.

        values = matrix @ q + offset, for q in the order of `joint_names` and names in the order of `joints`.
        """
        movable = [joint for joint in self.joints if joint.movable]
        matrix, offset = np.zeros((len(movable), len(self.joint_names))), np.zeros(len(movable))
        for row, joint in enumerate(movable):
            gain = 1.0
            while joint.mimic is not None:
                offset[row] += gain * joint.mimic.offset
                gain *= joint.mimic.multiplier
                joint = self.joints_by_name[joint.mimic.joint]
            matrix[row, self.joint_names.index(joint.name)] = gain
        return matrix, offset, tuple(joint.name for joint in movable)


def list_hands() -> tuple[str, ...]:
    """Names of the hands that come with the program, each a folder of robots/ with a hand.toml."""
    return tuple(sorted(file.parent.name for file in resource_dir("robots").glob(f"*/{HAND_TOML}")))


def needs_urdf(name: str) -> bool:
    """Whether the hand `name` of `list_hands()` comes without a URDF, so that the user has to give one."""
    return read_hand_toml(resource_dir("robots") / name / HAND_TOML).urdf is None


def load_hand(
    source: str | Path,
    *,
    base_link: str | None = None,
    urdf: str | Path | None = None,
    mjcf: str | Path | None = None,
    candidates: int = 1024,
) -> Hand:
    """The hand that `source` names: one of `list_hands()`, a folder, a .urdf file, or a hand.toml.

    A folder holds a hand.toml or exactly one .urdf file. The hand.toml beside a .urdf file is used if it
    names that file.

    Args:
        source: Name or path; a hand of ours wins over a folder of the same name, which is ./NAME.
        base_link: The hand is what hangs from this link; by default hand.toml's base_link, or else the root.
        urdf: Taken instead of the URDF that hand.toml names; hands of others come without one.
        mjcf: Taken instead of the MJCF that hand.toml names.
        candidates: Surface points per link.

    Raises:
        AssetError: no such name.
        HandError: a file is missing or malformed, or names something that is not there.
    """
    name, toml = _locate(source, None if urdf is None else Path(urdf).expanduser())
    if toml.urdf is None:
        raise HandError(f"hand '{name}' comes without a URDF: give yours with --urdf FILE")
    if mjcf is not None:
        toml = replace(toml, mjcf=Path(mjcf).expanduser())
        if not toml.mjcf.is_file():
            raise HandError(f"{mjcf}: no such MJCF file")
    if toml.collision == "mjcf" and toml.mjcf is None:
        raise HandError(f"{toml.path}: collision = 'mjcf' needs mjcf = \"FILE\", or --mjcf FILE")
    tree = read_tree(toml.urdf)
    base = base_link or toml.base_link or tree.root
    raw_links, joints = tree.below(base)
    hulls: dict[Path, Piece] = {}
    links = tuple(_link(raw, tree.path, hulls, candidates) for raw in raw_links)
    moving = {joint.name: joint for joint in joints if joint.movable and joint.mimic is None}
    independent = [moving[joint] for joint in tree.joints if joint in moving]
    outside = tree.joints.keys() - {joint.name for joint in joints}
    touching, notes = contacts(
        toml,
        [link.name for link in links if link.body is not None],
        joints,
        tree.links.keys() - {link.name for link in links},
    )
    notes += [f"joint '{j.name}' cannot move: its limits are equal" for j in independent if j.lower == j.upper]
    return Hand(
        name=name,
        urdf=tree.path,
        base_link=base,
        links=links,
        joints=tuple(joints),
        joint_names=tuple(joint.name for joint in independent),
        lower=np.array([joint.lower for joint in independent]),
        upper=np.array([joint.upper for joint in independent]),
        rest=rest_pose(toml, independent, outside),
        contacts=touching,
        notes=tuple(notes),
        actuator=actuator(toml, independent, outside),
        coupled=coupled(toml, independent, outside),
        mjcf=toml.mjcf,
        mjcf_joints=mjcf_joints(toml, [joint.name for joint in joints if joint.movable], outside),
        collision=toml.collision,
    )


def _locate(source: str | Path, urdf: Path | None) -> tuple[str, HandToml]:
    """The hand's name, and its hand.toml or, without one, an empty one that names its URDF."""
    if isinstance(source, str) and source in list_hands():
        source = resource_dir("robots") / source
    path = Path(source).expanduser()
    if not path.exists():
        choices = f"the hands here are {', '.join(list_hands())}; or give a folder, a .urdf file or a {HAND_TOML}"
        if isinstance(source, str) and path.name == source and not path.suffix:
            raise AssetError(f"no hand is called '{source}'; {choices}")
        raise HandError(f"{path}: no such file or folder; {choices}")
    folder = path if path.is_dir() else path.parent
    beside = folder / HAND_TOML
    if beside.is_file():
        toml = read_hand_toml(beside)
        named = path.is_dir() or path.samefile(beside)
        if named or (toml.urdf is not None and path.samefile(toml.urdf)):
            return folder.resolve().name, toml if urdf is None else replace(toml, urdf=urdf)
    if urdf is not None:
        raise HandError(f"--urdf {urdf}: goes with a hand that has a {HAND_TOML}, '{source}' has none")
    urdf = only_urdf(path) if path.is_dir() else path
    return (folder.resolve().name if path.is_dir() else path.stem), HandToml(urdf, urdf)


def _link(raw: yourdfpy.Link, urdf: Path, hulls: dict[Path, Piece], candidates: int) -> Link:
    pieces = link_pieces(raw, urdf, hulls)
    inertial = raw.inertial
    mass = inertial.mass if inertial is not None else None
    if mass is not None and mass < 0:
        raise HandError(f"{urdf}: link '{raw.name}' has the mass {mass:g} kg")
    inertia = None
    if mass is not None and inertial.inertia is not None:
        inertia = Inertia.about(mass, np.eye(4) if inertial.origin is None else inertial.origin, inertial.inertia)
    try:
        body = build_body(raw.name, pieces, candidates=candidates) if pieces else None
    except MeshError as error:
        raise HandError(f"{urdf}: link {error}") from None
    return Link(raw.name, body, mass, inertia)
