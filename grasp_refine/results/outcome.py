"""Outcome of a refinement: grasps before and after, measured by one plain query each."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from grasp_refine.closing.motion import Motion
from grasp_refine.core.array_records import ArrayRecord, join
from grasp_refine.core.profiling import stage
from grasp_refine.core.se3 import inverse, pose_from_transform, transform_from_pose, transform_points
from grasp_refine.core.short_repr import brief, labels
from grasp_refine.forces.squeeze_forces import SqueezeForces
from grasp_refine.hands.displacement import Displacement
from grasp_refine.hands.palm import palm_poses
from grasp_refine.measures.change import changes, contacts_moved, links_kept
from grasp_refine.measures.formulas import COSTLY_M, MeasuredGrasps, MeasuredRefinement
from grasp_refine.measures.geometry import Geometry, contact_errors, measure, movement
from grasp_refine.measures.measures import MEASURES, RECORDED
from grasp_refine.refinement.gap_closing import RELEASE_GAP_M
from grasp_refine.refinement.phases import KEEP
from grasp_refine.refinement.refine import Refinement
from grasp_refine.refinement.solvers.status import UNUSABLE, Status
from grasp_refine.results.weakness import weaknesses
from grasp_refine.scene.contact_links import contact_gaps
from grasp_refine.scene.contact_selection import ContactSelection
from grasp_refine.scene.hand_object import HandObject
from grasp_refine.scene.scene import Scene

WORDS = ("change", "fidelity", "fingers")
"""Texts on each grasp, beside the status of its refinement."""


@dataclass(frozen=True, eq=False)
class Outcome(ArrayRecord):
    """N grasps before and after; every array has one row per grasp, and per-link ones a column for each of L links."""

    object: np.ndarray
    """Name of the object (N,)."""
    scale: np.ndarray
    """Factor that takes the object's mesh to metres (N,)."""
    row: np.ndarray
    """Row in the grasp file (N,)."""
    index: np.ndarray
    """Number among the grasps of the object (N,)."""
    hand_pose: np.ndarray
    """Refined poses (N, 7) of the base link, x y z qw qx qy qz, object frame, metres."""
    q: np.ndarray
    """Refined joint values (N, n)."""
    hand_pose_before: np.ndarray
    """Poses (N, 7) before refinement, as `hand_pose`."""
    q_before: np.ndarray
    """Joint values (N, n) before refinement."""
    status: np.ndarray
    """A `Status` (N,)."""
    change: np.ndarray
    """A `Change` (N,) as text; empty for grasps that were not refined at all."""
    fidelity: np.ndarray
    """A `Likeness` (N,) of transferred grasps as text; empty for others."""
    fingers: np.ndarray
    """Text on each finger of the originals of transferred grasps (N,), as `Fidelity.texts`; empty for others."""
    measures: Mapping[str, np.ndarray]
    """Name of a measure of `RECORDED` -> its values (N, 2) before and after, or (N,) after alone; SI units."""
    contact_gap: np.ndarray
    """Gap that each contact link (N, L) of the refined grasps should keep from the object, metres, as `contact_gaps`;
    NaN for other links."""
    target_point_link: np.ndarray
    """Target points on the links (N, L, 3), link frames, metres; NaN: none."""
    target_point_object: np.ndarray
    """Target points on the object (N, L, 3), object frame, metres."""
    contact_point_link: np.ndarray
    """Refined witness points on links that should touch (N, L, 3), link frames, metres; NaN for other links."""
    contact_point_object: np.ndarray
    """Refined witness points on the object (N, L, 3), object frame, metres."""
    contact_normal: np.ndarray
    """Unit normals from link to object at the witness points (N, L, 3), object frame."""
    contact_distance: np.ndarray
    """Signed distances at the witness points (N, L), metres."""
    contact_probability: np.ndarray
    """Probability (N, L) that a link touches a scanned object when the hand closes on it; NaN for other objects."""
    stage_pose: np.ndarray
    """Poses (N, 3, 7) of the base link at pregrasp, grasp and squeeze, as `hand_pose`."""
    stage_q: np.ndarray
    """Joint values (N, 3, n) at these stages; a squeeze may exceed the limits."""
    gap: np.ndarray
    """Text on the contact link of the refined grasps (N,) that is farthest from touching, such as "1.8 mm at thumb";
    empty up to `RELEASE_GAP_M`."""
    weakness: np.ndarray
    """Text on what costs the refined grasps (N,) most quality; empty where nothing does."""
    labels: Mapping[str, np.ndarray] = field(default_factory=dict)
    """Numbers (N,) that the generator gave the grasps, as `GraspSet.labels`."""
    forces: SqueezeForces | None = None
    """Forces that the squeezes are planned for; None: not known."""

    __repr__ = brief

    def __len__(self) -> int:
        """Return the number of grasps."""
        return len(self.status)

    @property
    def touching(self) -> np.ndarray:
        """Contact links (N, L) of the refined grasps."""
        return ~np.isnan(self.contact_gap)

    @property
    def usable(self) -> np.ndarray:
        """True where a grasp (N,) was refined at all: it had links to touch with, and its queries succeeded."""
        return ~np.isin(self.status, UNUSABLE)

    @property
    def motion(self) -> Motion:
        """Pregrasps, grasps and squeezes."""
        return Motion(transform_from_pose(self.stage_pose), self.stage_q)

    def posed(self, scene: Scene) -> Scene:
        """Return the scene of N grasps with the refined ones."""
        T = transform_from_pose(self.hand_pose)
        return replace(scene, T_world_root=T, q=self.q, contact_gap=self.contact_gap)

    @property
    def aimed(self) -> np.ndarray:
        """True where a grasp (N,) had targets."""
        return ~np.isnan(self.target_point_link).all(axis=(1, 2))

    def __getitem__(self, name: str) -> np.ndarray:
        """Return the values of a measure before and after (N, 2), or after alone (N,)."""
        return self.measures[name]

    @property
    def quality(self) -> np.ndarray:
        """Quality before and after (N, 2), from 0 to 1; NaN where a grasp is not finite, or has no contacts."""
        return self["quality"]

    def texts(self) -> dict[str, np.ndarray]:
        """Return the texts (N,) as result files have them: on the refinement, and on the fidelity of transfers."""
        words = {name: getattr(self, name) for name in WORDS}
        return {"status": labels(Status, self.status), **words}

    def likely_contact(self, links: tuple[str, ...], link: str) -> str:
        """Return the probability that a link of the first grasp touches, as the end of a sentence on it.

        Args:
            links: Links with collision geometry, as in `Scene.links`.
            link: Name of a link; the text on one without geometry, or on an object that was not scanned, is empty.
        """
        found = self.contact_probability[0, links.index(link)] if link in links else np.nan
        return "" if np.isnan(found) else f"; touches {100 * found:.0f} % of what the object may be"

    def entries(self) -> dict[str, np.ndarray]:
        """Return the measures as result files have them: `Measure.entries` -> values (N,), SI units."""
        return {
            entry: values[:, column] if values.ndim == 2 else values
            for name, values in self.measures.items()
            for column, entry in enumerate(MEASURES[name].entries.values())
        }


@stage("measuring")
def compare(
    scene: Scene,
    refinement: Refinement,
    motion: Motion,
    *,
    margin: float,
    clearance: np.ndarray | float = 0.0,
    selection: ContactSelection | None = None,
    name: str,
    scale: float,
    row: np.ndarray,
    index: np.ndarray,
) -> Outcome:
    """Return the outcome of refining a scene.

    Args:
        scene: Scene before the refinement.
        refinement: Refined grasps.
        motion: Motion that closes the hand to the refined grasps.
        margin: Gap in metres that contact links should keep.
        clearance: Gap (L,) in metres that links without a target keep beside it.
        selection: Selection of the contact links of input grasps (`contact_gaps`); None: the defaults.
        name: The object's name in results.
        scale: Factor that took the object's mesh to metres.
        row: Rows of the grasps (N,) in their file.
        index: Numbers of the grasps (N,) within their object.
    """
    count = len(scene.q)
    # Invalid poses have no measures.
    before = scene.masked(scene.posed)
    T_after = np.where(scene.posed[:, None, None], refinement.T_world_root, np.nan)
    q_after = np.where(scene.posed[:, None], refinement.q, np.nan)
    T, q = np.concatenate([before.T_world_root, T_after]), np.concatenate([before.q, q_after])
    aimed = ~np.isnan(refinement.target_link[..., 0])
    targets = tuple(np.concatenate([one, one]) for one in (refinement.target_link, refinement.target_object))
    geometry = measure(HandObject.of(scene), T, q, *targets)
    gap_after = np.where(refinement.touching, margin + np.where(aimed, 0.0, clearance), np.nan)
    gaps = np.concatenate([contact_gaps(before, geometry.witness.rows(slice(count)), selection), gap_after])
    errors = contact_errors(geometry.distance, geometry.witness, geometry.T_world_link, gaps, *targets)
    geometry = replace(geometry, contact_error=errors)
    original = None if scene.original is None else join(scene.original, scene.original)
    grasps = MeasuredGrasps(scene.hand, scene.object, scene.links, T, q, geometry, scene.task, original)
    # Links that are part of the input grasp, whatever should touch besides.
    plain, near = replace(before, target_link=None, target_object=None), KEEP.touching(selection or ContactSelection())
    own = ~np.isnan(contact_gaps(plain, geometry.witness.rows(slice(count)), near))
    touching = own, refinement.touching
    moved = _measured(before, refinement, T_after, q_after, geometry, touching)
    measures = {}
    for each in RECORDED:
        values = each.values(grasps if each.of_grasps else moved)
        if each.of_grasps:
            values = np.stack([values[:count], values[count:]], axis=1) if each.compared else values[count:]
        measures[each.name] = values
    witness = geometry.witness.rows(slice(count, None))
    contacts = refinement.touching & witness.valid
    T_link = geometry.T_world_link[count:]
    # As given, also where that is no valid pose.
    with np.errstate(all="ignore"):
        pose_before, pose_after = (pose_from_transform(one.T_world_root) for one in (scene, refinement))

    def at_contacts(values: np.ndarray) -> np.ndarray:
        return np.where(contacts.reshape(contacts.shape + (1,) * (values.ndim - 2)), values, np.nan)

    return Outcome(
        object=np.full(count, name),
        scale=np.full(count, scale),
        row=row,
        index=index,
        hand_pose=pose_after,
        q=refinement.q,
        hand_pose_before=pose_before,
        q_before=scene.q,
        status=refinement.status,
        change=np.where(np.isin(refinement.status, UNUSABLE), "", changes(*touching, moved.contacts_moved)),
        fidelity=np.full(count, "") if grasps.fidelity is None else grasps.fidelity.likeness[count:],
        fingers=np.full(count, "") if grasps.fidelity is None else grasps.fidelity.texts(scene.hand.fingers)[count:],
        measures=measures,
        contact_gap=gap_after,
        target_point_link=refinement.target_link,
        target_point_object=refinement.target_object,
        contact_point_link=at_contacts(transform_points(inverse(T_link), witness.point_a)),
        contact_point_object=at_contacts(witness.point_b),
        contact_normal=at_contacts(witness.normal),
        contact_distance=at_contacts(witness.distance),
        contact_probability=np.full(contacts.shape, np.nan),
        stage_pose=pose_from_transform(motion.T_world_root),
        stage_q=motion.q,
        gap=np.array([_gap_text(scene.links, error) for error in errors[count:]], dtype=np.str_),
        weakness=np.array(_weaknesses(grasps)[count:], dtype=np.str_),
        forces=motion.forces,
    )


def _measured(
    before: Scene,
    refinement: Refinement,
    T_after: np.ndarray,
    q_after: np.ndarray,
    geometry: Geometry,
    touching: tuple[np.ndarray, np.ndarray],
) -> MeasuredRefinement:
    """Return effort and movement of a refinement.

    Args:
        before: Input grasps; NaN where they have no valid pose.
        refinement: Refined grasps.
        T_after: Their poses (N, 4, 4), NaN like `before`.
        q_after: Their joint values (N, n).
        geometry: Geometry of the input grasps and of the refined ones (2 N).
        touching: Contact links (N, L) before and after.
    """
    hand, own, count = before.hand, ~before.hand.arm_joints, len(q_after)
    T_palm = palm_poses(hand, before.T_world_root, before.q), palm_poses(hand, T_after, q_after)
    T_link, witness = geometry.T_world_link, geometry.witness.rows(slice(count))
    with np.errstate(invalid="ignore"):
        displaced = Displacement.of(hand).between(before.T_world_root, before.q, T_after, q_after)
        contacts = contacts_moved(touching[0] & touching[1], witness, T_link[:count], T_link[count:])
    return MeasuredRefinement(
        **{name: getattr(refinement, name) for name in ("starts", "iterations", "queries", "cpu_s", "wall_s")},
        loss=refinement.loss[:, 1],
        movement=movement(T_palm[0], before.q[:, own], T_palm[1], q_after[:, own], hand.slides[own]),
        displacement=displaced,
        contacts_moved=contacts,
        links_kept=links_kept(*touching),
    )


def _gap_text(links: Sequence[str], error: np.ndarray) -> str:
    """Return the text on the largest contact error of the links (L,), in metres, NaN for links that need not touch."""
    error = np.nan_to_num(error)
    worst = int(error.argmax())
    return f"{1e3 * error[worst]:.1f} mm at {links[worst]}" if error[worst] > RELEASE_GAP_M else ""


def _weaknesses(grasps: MeasuredGrasps) -> list[str]:
    """Return the texts of `weaknesses`; of grasps with a link where it should not be, on that."""
    hand, links = grasps.hand, grasps.links
    inside: dict[int, str] = {}
    if grasps.environment is not None and (found := grasps.scene_depths) is not None:
        for i in np.flatnonzero(found.depth > COSTLY_M[0]).tolist():
            body = grasps.environment.bodies[found.body[i]].name
            inside[i] = f"{links[found.link[i]]} is {1e3 * found.depth[i]:.1f} mm in {body}"
    if (depths := grasps.table_depths) is not None:
        for i in np.flatnonzero(depths.max(axis=1) > COSTLY_M[0]).tolist():
            at = int(depths[i].argmax())
            inside[i] = f"{links[at]} is {1e3 * depths[i, at]:.1f} mm below the table"
    if grasps.regions is not None and (misses := grasps.contact_misses) is not None:
        for i in np.flatnonzero(misses.miss.max(axis=1) > COSTLY_M[0]).tolist():
            at = int(misses.miss[i].argmax())
            why = f"{links[at]} touches {grasps.regions.reason(misses.point[i, at])}"
            inside[i] = f"{inside[i]}; {why}" if i in inside else why
    passive = tuple(mode.joint for mode in hand.modes)
    texts = weaknesses(grasps.quality, links, hand.joint_names, passive, grasps.demand)
    return [inside.get(i, text) for i, text in enumerate(texts)]
