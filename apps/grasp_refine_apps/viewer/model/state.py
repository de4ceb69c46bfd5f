"""State of the viewer as one frozen value: the controller makes new ones, the view draws them."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any, Literal

import numpy as np

from grasp_refine.core.array_types import Float
from grasp_refine.objects.region import ContactRegions
from grasp_refine.results.outcome import Outcome
from grasp_refine.scene.protocols.dexgraspbench import DEXGRASPBENCH
from grasp_refine.scene.protocols.registry import PROTOCOLS, default_protocol
from grasp_refine.scene.scene import Scene
from grasp_refine_apps.viewer.model.collection import Collection
from grasp_refine_apps.viewer.model.listing import Listing
from grasp_refine_apps.viewer.model.painting import Brush
from grasp_refine_apps.viewer.model.pose import Pose, Target
from grasp_refine_apps.viewer.model.recording import Recording
from grasp_refine_apps.viewer.model.trace import Trace
from grasp_refine_apps.viewer.model.validated import TrialResult
from grasp_refine_apps.viewer.model.work import Work, Works

JobKind = Literal[
    "load", "cut", "measure", "targets", "refine", "batch", "validate", "plan", "replay", "pull", "export"
]
Gizmo = Literal["none", "hand", "object", "fingers"]

MAX_SHELVED = 6
"""Number of the last opened files that are kept; files with unsaved grasps are always kept."""


@dataclass(frozen=True)
class Job:
    """Long job of the worker."""

    kind: JobKind
    """Kind of the job."""
    what: str
    """Description of the job for users."""
    share: float | None = None
    """Completed share, 0 to 1; None: unknown."""
    paused: bool = False
    """Whether it waits for the user."""


@dataclass(frozen=True)
class Notice:
    """Message that the user is shown once."""

    number: int
    """Running number, so that the same text can be shown twice."""
    text: str
    """Text of the message."""
    bad: bool = False
    """Whether something went wrong."""


@dataclass(frozen=True)
class DisplayOptions:
    """Display options of the scene."""

    hand: Literal["visual", "collision"] = "visual"
    """Its visual meshes, or the convex pieces that collide."""
    object: Literal["mesh", "pieces", "wireframe"] = "mesh"
    """Its surface, its convex pieces in colours, or its edges."""
    transparent: bool = True
    """See through the object, to contacts behind it."""
    input_hand: bool = True
    """A pale copy of the hand before refinement."""
    contacts: bool = True
    """Points where links and object are nearest or deepest, and lines between them."""
    overlap: bool = True
    """Depth of links in the object and of the object in them, as colours where they overlap; takes up to 0.1 s for each
    such link after each move, and nothing where none is."""
    gaps: bool = False
    """Distance of links from the object as colours on them, up to 3 mm, by the scale above the tabs; takes up to 0.1 s
    for each link that is near after each move."""
    forces: bool = False
    """The contact forces that balance best, and friction cones."""
    frames: bool = False
    """Axes of the base link and of the object: x red, y green, z blue."""
    surroundings: bool = True
    """The table and other bodies around the object, where there are any; obstacles are red."""
    regions: bool = True
    """Whether regions, if there are any, are tinted: green where links may touch the object, red where they may not."""
    scan: bool = True
    """Of a scanned object, the points that were seen, and the edges of the other solids that it may be."""
    ground: bool = True
    """The ground, with the shadow of hand and object; a cell is 5 cm wide."""


_OF_WORK = frozenset(field.name for field in fields(Work))
"""Fields of a state taken from the shown grasp's work."""


@dataclass(frozen=True, eq=False)
class Shelved:
    """Grasps that were open before, with their work."""

    collection: Collection
    """The grasps, as in their files."""
    number: int
    """Number of the grasp that was shown."""
    works: Works
    """Works on them."""
    listing: Listing
    """Filters and sorting of their list."""

    @property
    def unsaved(self) -> tuple[int, ...]:
        """Numbers of the grasps that were edited or refined, and not saved since."""
        return tuple(number for number, work in sorted(self.works.items()) if work.unsaved)


@dataclass(frozen=True, eq=False)
class State:
    """State of the viewer: the open grasps with their work, and the display of one of them."""

    collection: Collection
    """Open grasps, as in their files."""
    number: int
    """Number of the shown grasp."""
    scene: Scene
    """Hand, object and table, and the shown grasp alone as in its file."""
    initial: Pose
    """Pose of the hand in the input grasp, before any refinement."""
    works: Works
    """Works on the grasps, by number; the shown one always has an entry."""
    settings: Any
    """Options of refinement: a dataclass with `config` for a `Config`, and `unused` for unused fields."""
    protocol: tuple[str, float | None] = (DEXGRASPBENCH.name, None)
    """Name of the protocol of the next simulations, and its friction; None: its own."""
    listing: Listing = Listing()
    """Filters and sorting of the list of grasps."""
    shelf: tuple[Shelved, ...] = ()
    """Grasps that were open before, the last one first."""
    compared: Shelved | None = None
    """Grasps that are compared with the open ones, number by number."""
    job: Job | None = None
    """Running job."""
    gizmo: Gizmo = "none"
    """Body that can be dragged; fingers are dragged by their links."""
    brush: Brush = "off"
    """Kind of region that the mouse paints on the object."""
    picking: bool = False
    """Whether clicks on links and on the object set targets."""
    picked: tuple[str, Float[np.ndarray, " 3"]] | None = None
    """Clicked link, and the point on it (3,), link frame, until a point on the object is clicked."""
    motion: Recording | None = None
    """Shown simulation, or trajectory."""
    motion_frame: int = 0
    """Number of its shown frame."""
    display: DisplayOptions = DisplayOptions()
    """Display options of the scene."""
    side_by_side: bool = False
    """Whether the input grasp is drawn beside, with its own object."""
    notice: Notice | None = None
    """Last message to the user."""
    change: int = 0
    """Running number of the state."""

    @staticmethod
    def first(collection: Collection, number: int, settings: Any) -> State:
        """Return the state that shows a grasp as in its file, without anything made of any."""
        works = {number: collection.work(number)}
        scene = collection.scene(number)
        named = scene.task.test(patches=scene.hand.patches).name
        protocol = named if named in PROTOCOLS else default_protocol(in_scene=scene.environment is not None).name
        return State(collection, number, scene, Pose(*collection.initial(number)), works, settings, (protocol, None))

    def showing(self, collection: Collection, number: int) -> State:
        """Return the state with another grasp shown; works on grasps of the same file stay, and so do options."""
        shown = State.first(collection, number, self.settings)
        options = ("job", "gizmo", "brush", "display", "side_by_side", "notice", "protocol", "change")
        shown = replace(shown, **{name: getattr(self, name) for name in options})
        if collection.same_grasps(self.collection):
            works = {**shown.works, **self.works}
            return replace(shown, works=works, listing=self.listing, shelf=self.shelf, compared=self.compared)
        # The same grasps, with more known of their objects, take the place of the old ones.
        better = self.collection.files == collection.files and collection.stand_ins < self.collection.stand_ins
        shelf = self.shelf if better and not self.unsaved else (self.shelved, *self.shelf)
        return replace(shown, shelf=tuple(each for at, each in enumerate(shelf) if at < MAX_SHELVED or each.unsaved))

    def evolve(self, **changes: Any) -> State:
        """Return the state with other fields, of itself or of the shown grasp's work."""
        own = {name: value for name, value in changes.items() if name not in _OF_WORK}
        of_work = {name: value for name, value in changes.items() if name in _OF_WORK}
        state = replace(self, **own)
        return state.with_work(state.number, replace(state.work, **of_work)) if of_work else state

    def with_work(self, number: int, work: Work) -> State:
        """Return the state with other work on a grasp."""
        return replace(self, works={**self.works, number: work})

    def with_regions(self, regions: ContactRegions) -> State:
        """Return the state with other regions of the shown object, for all grasps on it."""
        collection = self.collection.with_regions(int(self.collection.group_of[self.number]), regions)
        return self.evolve(collection=collection, scene=collection.scene(self.number))

    @property
    def work(self) -> Work:
        """Work on the shown grasp."""
        return self.works[self.number]

    @property
    def pose(self) -> Pose:
        """`Work.pose` of the shown grasp."""
        return self.work.pose

    @property
    def targets(self) -> tuple[Target, ...]:
        """`Work.targets` of the shown grasp."""
        return self.work.targets

    @property
    def T_world_object(self) -> Float[np.ndarray, "4 4"]:
        """`Work.T_world_object` of the shown grasp."""
        return self.work.T_world_object

    @property
    def trace(self) -> Trace | None:
        """`Work.trace` of the shown grasp."""
        return self.work.trace

    @property
    def recording(self) -> Recording | None:
        """The shown simulation or trajectory, else the iterations of the last refinement."""
        return self.trace if self.motion is None else self.motion

    @property
    def frame(self) -> int | None:
        """`Work.frame` of the shown grasp."""
        return self.work.frame

    @property
    def outcome(self) -> Outcome | None:
        """`Work.outcome` of the shown grasp."""
        return self.work.outcome

    @property
    def trial(self) -> TrialResult | None:
        """`Work.trial` of the shown grasp."""
        return self.work.trial

    @property
    def undo_steps(self) -> tuple[Work, ...]:
        """`Work.undo_steps` of the shown grasp."""
        return self.work.undo_steps

    @property
    def redo_steps(self) -> tuple[Work, ...]:
        """`Work.redo_steps` of the shown grasp."""
        return self.work.redo_steps

    @property
    def shown(self) -> Pose:
        """Drawn pose of the hand, in the object's frame; in a simulation, in that of the object at its start."""
        return self.work.standing if self.motion is None else self.motion.pose(self.motion_frame)

    @property
    def standing(self) -> Pose:
        """Pose of the hand for the next command: as shown, except in a simulation, which is only displayed."""
        return self.work.standing

    @property
    def T_shown_object(self) -> Float[np.ndarray, "4 4"]:
        """Pose of the object (4, 4) in the frame of `shown`: it moves in simulations only."""
        return np.eye(4) if self.motion is None else self.motion.object_pose(self.motion_frame)

    @property
    def pressure_n(self) -> float:
        """Sum of the normal forces of all contacts in newtons, of the last refinement or of the task."""
        config = self.work.config
        planned = None if config is None else config.pressure
        return self.scene.demand.pressure_n if planned is None else float(planned)

    @property
    def shelved(self) -> Shelved:
        """The open grasps, to be put on the shelf."""
        return Shelved(self.collection, self.number, self.works, self.listing)

    @property
    def unsaved(self) -> tuple[int, ...]:
        """Numbers of the open grasps that were edited or refined, and not saved since."""
        return self.shelved.unsaved

    @property
    def num_unsaved(self) -> int:
        """Number of grasps, including the shelf, that were edited or refined, and not saved since."""
        return sum(len(each.unsaved) for each in (self.shelved, *self.shelf))
