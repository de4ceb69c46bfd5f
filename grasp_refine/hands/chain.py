"""Forward kinematics of a hand with its geometric Jacobian, for solvers that call it in their inner loop.

Written against the array API, with few operations whatever the hand: at a batch of one the time goes into
dispatching them. `kinematics.Kinematics` has gradients by autograd.

Every movable joint gets a frame of its own: it moves with the child, has its origin and has the joint's axis as z.
Fixed joints, and the rotations that align the axes, are folded into constant transforms between these frames.
Twists are as in `se3`: spatial, (v, w), V(p) = v + w x p about the world's origin.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from types import ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np

from grasp_refine.collision.engine import chosen
from grasp_refine.core.arguments import check_alike, check_kind, check_shape
from grasp_refine.core.array_types import Bool
from grasp_refine.core.profiling import stage
from grasp_refine.core.se3 import Array, array_namespace, exp_so3, inverse, tangents, transform
from grasp_refine.core.short_repr import brief
from grasp_refine.hands.hand import Hand
from grasp_refine.hands.kept import kept

if TYPE_CHECKING:
    from grasp_refine.hands.native_chain import NativeChain

Selection = Array | slice
"""Indices along an axis: an array or, where they are consecutive, a slice, which copies nothing."""


class Chain:
    """Poses of chosen links of a hand, and their Jacobian in root twist and joint values."""

    links: tuple[str, ...]
    """The chosen links, in the given order."""
    joints: tuple[str, ...]
    """The m movable joints that move any of the links: by the independent joint that they follow, then as in `hand`."""
    dof: int
    """Number n of independent joints of the hand, including joints that move none of the links."""

    def __init__(self, hand: Hand, links: Sequence[str]) -> None:
        """Prepare the chain down to `links`; joints that move none of them are left out.

        Raises:
            HandError: the hand has no link of such a name.
            GraspRefineError: an argument of another kind.
        """
        check_kind("hand", hand, Hand)
        check_kind("links", tuple(links) if isinstance(links, list) else links, tuple[str, ...])
        self.links, self.dof = tuple(links), len(hand.joint_names)
        self.joints, self._numbers = _build(hand, self.links)
        self._converted: dict[tuple[Any, Any], Numbers] = {}

    @stage("kinematics")
    def __call__(self, T_world_root: Array, q: Array) -> Frames:
        """Poses and joint axes at root poses (batch, 4, 4) and independent joint values (batch, n).

        The values are in `hand.joint_names` order: radians, metres for prismatic joints.

        Raises:
            GraspRefineError: other shapes.
        """
        check_alike(T_world_root, q)
        check_shape("q", q, "batch", self.dof, why="one column for each of hand.joint_names")
        check_shape("T_world_root", T_world_root, len(q), 4, 4, why="one transform for each row of q")
        xp = array_namespace(q)
        if _is_native(q):
            T_world_link, axes = self._numbers.compiled.forward(T_world_root, q)
            return Frames(T_world_link, axes, T_world_root, q)
        numbers = self._constants_on(xp, q)
        values = q @ numbers.values_matrix + numbers.values_offset
        slope = None
        if numbers.higher is not None:
            curved, slope = _curved(xp, q[:, numbers.leaders], numbers.slope_offset, numbers.higher)
            values, slope = values + curved, slope[:, numbers.column_order, None]
        # T_parent_joint is linear in the cosine, the sine and the value.
        T = numbers.T_constant + xp.cos(values)[..., None, None] * numbers.T_cos
        T = T + xp.sin(values)[..., None, None] * numbers.T_sin
        if numbers.slides is not None:
            T = T + values[..., None, None] * numbers.T_value
        levels = [T_world_root[:, None]]
        for parents, level in numbers.levels:
            levels.append(levels[-1][:, parents] @ T[:, level])
        T_world_joint = xp.concat(levels, axis=1)  # the root's own frame is number 0

        T_world_link = T_world_joint[:, numbers.link_frames] @ numbers.T_frame_link
        moving = T_world_joint[:, numbers.joint_frames]
        # All products of origin (p, 1) and axis (z, 0): p x z and z are linear in them.
        products = moving[..., 3:] * moving[..., None, :, 2]
        products = products.reshape(*moving.shape[:2], 16)
        twists = products @ numbers.hinge_twist
        if numbers.slides is not None:
            twists = xp.where(numbers.slides, products @ numbers.slide_twist, twists)
        if slope is not None:
            twists = twists * slope
        root_twists = (T_world_root[:, :, 3] @ numbers.root_twist).reshape(-1, 6, 6)
        axes = xp.matrix_transpose(xp.concat([root_twists, twists], axis=1))
        return Frames(T_world_link, axes, T_world_root, q)

    def to_joint_space(
        self, frames: Frames, covector: Array, link: np.ndarray, minus: np.ndarray | None = None
    ) -> Array:
        """Covectors on root twist and joint values (batch, R, 6 + n), from covectors (batch, R, 6) on twists of links.

        Row r is the derivative of a quantity that changes by covector[r] . (v, w), where (v, w) is the spatial twist
        of link[r], less that of minus[r]: exact, by the geometric Jacobian. Root twists are as in `integrate`. The
        child of joint i of `joints` has the index len(links) + i among the links.

        Args:
            frames: Result of the call.
            covector: Forces and moments about the world's origin, or any other linear form of the twist.
            link: Index (R,) or (batch, R) of each row's link in `Chain.links`.
            minus: Index of the link whose twist is subtracted, likewise.
        """
        if _is_native(covector):
            return self._numbers.compiled.to_joint_space(frames.axes, covector, link, minus)
        numbers = self._constants_on(array_namespace(covector), covector)
        follows = numbers.follows
        mask = follows[link] if minus is None else follows[link] - follows[minus]
        if not isinstance(covector, np.ndarray):
            xp = array_namespace(covector)
            mask = xp.asarray(mask, dtype=covector.dtype, device=covector.device)
        joint_covectors = (covector @ frames.axes) * mask
        return joint_covectors if numbers.gains is None else joint_covectors @ numbers.gains

    @property
    def joint_gains(self) -> np.ndarray:
        """Movements (m, n) of `joints` per independent joint value, in the units of the axes of `Frames`."""
        gains = self._numbers.gains
        return np.eye(len(self.joints), self.dof) if gains is None else np.asarray(gains)[6:, 6:]

    def joint_mask(self, link: np.ndarray) -> np.ndarray:
        """Mask (R, 6 + m): 1 where a root twist or joint of `joints` moves the link, else 0; see `to_joint_space`."""
        return self._numbers.follows[link]

    @property
    def moves(self) -> Bool[np.ndarray, "L n"]:
        """True (L, n) where an independent joint moves a link."""
        return (self.joint_mask(np.arange(len(self.links)))[:, 6:] @ (self.joint_gains != 0.0)) > 0.0

    def _constants_on(self, xp: ModuleType, like: Array) -> Numbers:
        """The constants in the array library `xp`, with the number type and on the device of `like`."""
        key = (like.dtype, like.device)
        if key not in self._converted:
            self._converted[key] = self._numbers.converted(xp, *key)
        return self._converted[key]


@dataclass(frozen=True, eq=False)
class Frames:
    """Poses of the links of a chain at one configuration, and their derivatives."""

    T_world_link: Array
    """Poses (batch, links, 4, 4) of the links."""
    axes: Array
    """Unit twists (batch, 6, 6 + m) as columns, spatial (v, w) about the world's origin, in m/m, m/rad or rad/rad.

    First the root's: translation along the three world axes, rotation about the three world axes through the
    root's origin. Then the axes of `Chain.joints`; of one that follows another on a curve, per unit of the other.
    """
    T_world_root: Array
    """Poses (batch, 4, 4) of the root."""
    q: Array
    """Values (batch, n) of the independent joints."""

    __repr__ = brief


def _is_native(values: Array) -> bool:
    """Return whether the compiled engine takes these values: it has double precision, and no graph."""
    return isinstance(values, np.ndarray) and values.dtype == np.float64 and chosen("auto") == "native"


def integrate(T_world_root: Array, dx: Array) -> Array:
    """Root poses (..., 4, 4) after steps dx = (v, w) (..., 6): R <- exp(w) R and p <- p + v.

    The root's origin moves by v (m) and the hand turns about it by the world-frame rotation vector w (rad). One
    Newton step towards the nearest rotation removes the rounding that many such steps would accumulate.
    """
    xp = array_namespace(dx)
    R = exp_so3(dx[..., 3:]) @ T_world_root[..., :3, :3]
    R = 1.5 * R - 0.5 * (R @ (xp.matrix_transpose(R) @ R))
    return transform(R, T_world_root[..., :3, 3] + dx[..., :3])


# constants


@dataclass(frozen=True, eq=False)
class Numbers:
    """The constants of a chain. Its m joints are sorted by their depth below the root, level by level."""

    values_matrix: Array
    """(n, m): joint values are q @ values_matrix + values_offset."""
    values_offset: Array
    """(m,)"""
    T_constant: Array
    """(m, 4, 4): T_parent_joint is T_constant + cos(value) T_cos + sin(value) T_sin + value T_value."""
    T_cos: Array
    """(m, 4, 4)"""
    T_sin: Array
    """(m, 4, 4)"""
    T_value: Array
    """(m, 4, 4)"""
    levels: tuple[tuple[Selection, slice], ...]
    """For each level of joints: their parents' indices in the level above, and their slice of the m joints."""
    link_frames: Selection
    """Frame of each link: 0 is the root's, 1 + i that of joint i."""
    T_frame_link: Array
    """(links, 4, 4)"""
    joint_frames: Selection
    """Frame of each of `Chain.joints`."""
    root_twist: Array
    """(4, 36): the root's six unit twists as rows, as a linear form of its origin (p, 1)."""
    hinge_twist: Array
    """(16, 6): a hinge's unit twist (p x z, z) as a linear form of the products (p, 1) (z, 0)^T."""
    slide_twist: Array
    """(16, 6): a prismatic joint's unit twist (z, 0) as a linear form of the same products."""
    slides: Array | None
    """(m, 1): True where one of `Chain.joints` is prismatic; None if none is."""
    leaders: Array | None
    """(m,): index of the independent joint that each joint follows; None where no coupling is curved."""
    slope_offset: Array | None
    """(m,): slope at 0 of the values of joints that follow on a curve, 1 for others."""
    higher: Array | None
    """(m, d): coefficients of the second and higher powers of these joints."""
    column_order: Array | None
    """(m,): place among the m joints, by level, of each of `Chain.joints`."""
    gains: Array | None
    """(6 + m, 6 + n): root twist and joint values per root twist and q; None for the identity."""
    follows: np.ndarray
    """(links + m, 6 + m): 1 where the root twist or joint moves the link, or the joint's child, else 0; always a NumPy
    array."""

    @cached_property
    def compiled(self) -> NativeChain:
        """The constants in the compiled engine."""
        from grasp_refine.hands.native_chain import NativeChain

        n, m = self.values_matrix.shape
        columns = self.follows.shape[1]
        # Frames by level: 0 is the root's, 1 + i that of joint i.
        frames = [np.zeros(1, dtype=np.int64), *(1 + np.arange(m)[level] for _, level in self.levels)]
        parents = [above[chosen] for above, (chosen, _) in zip(frames[:-1], self.levels, strict=True)]
        slides = np.zeros(columns - 6, dtype=bool) if self.slides is None else self.slides[:, 0]
        return NativeChain(
            self.values_matrix.T, self.values_offset, self.T_constant, self.T_cos, self.T_sin, self.T_value,
            np.concatenate([np.zeros(0, dtype=np.int64), *parents]), np.arange(m + 1)[self.link_frames],
            self.T_frame_link, np.arange(m + 1)[self.joint_frames] - 1, slides.astype(np.uint8),
            self.leaders, self.slope_offset, self.higher, self.gains, self.follows.astype(np.uint8),
            shape=(len(self.T_frame_link), columns, columns if self.gains is None else 6 + n),
        )  # fmt: skip

    def converted(self, xp: ModuleType, dtype: Any, device: Any) -> Numbers:
        """Return the constants in another array library, number type or device."""

        def convert(value: Any) -> Any:
            if isinstance(value, tuple):
                return tuple(convert(item) for item in value)
            if isinstance(value, np.ndarray):
                return xp.asarray(value, dtype=dtype if value.dtype.kind == "f" else None, device=device)
            return value

        changed = {field.name: convert(getattr(self, field.name)) for field in fields(self) if field.name != "follows"}
        # On NumPy arrays `follows` has their number type, so that a product keeps it; others convert its rows.
        follows = self.follows.astype(dtype) if xp is np else self.follows
        return Numbers(**changed, follows=follows)


@kept
def _build(hand: Hand, links: tuple[str, ...]) -> tuple[tuple[str, ...], Numbers]:
    """The names of the joints that move any of `links`, in the order of `Chain.joints`, and the constants."""
    # Each link as (movable joint that carries it or None, pose in that joint's frame).
    carrier: dict[str, tuple[str | None, np.ndarray]] = {hand.base_link: (None, np.eye(4))}
    parent: dict[str | None, str | None] = {}
    T_parent_joint: dict[str, np.ndarray] = {}  # at value 0
    for joint in hand.joints_to(links):
        above, T = carrier[joint.parent]
        T = T @ joint.T_parent_child
        if joint.movable:
            aligned = transform(np.column_stack([tangents(joint.axis), joint.axis]), np.zeros(3))
            parent[joint.name], T_parent_joint[joint.name] = above, T @ aligned
            above, T = joint.name, inverse(aligned)
        carrier[joint.child] = above, T

    depth: dict[str | None, int] = {None: 0}
    for name in parent:
        depth[name] = depth[parent[name]] + 1
    height = dict.fromkeys([None, *parent], 0)
    for name in reversed(parent):
        height[parent[name]] = max(height[parent[name]], height[name] + 1)
    # Of chains of different lengths the longest come first, so that parents are mostly the first of a level.
    levels: list[list[str | None]] = [[None]]
    for level in range(1, height[None] + 1):
        place = {name: i for i, name in enumerate(levels[-1])}
        joints = [name for name in parent if depth[name] == level]
        levels.append(sorted(joints, key=lambda name: (-height[name], place[parent[name]])))
    frames = [name for level in levels for name in level]
    sorted_joints = [name for name in frames if name is not None]
    ends = np.cumsum([len(level) for level in levels]) - 1

    matrix, offset, names = hand.mimic_map()
    rows = [names.index(name) for name in sorted_joints]
    followed = {name: int(np.flatnonzero(row)[0]) if row.any() else 0 for name, row in zip(names, matrix, strict=True)}
    columns = sorted((name for name in parent if name is not None), key=lambda name: followed[name])
    m, n = len(columns), len(hand.joint_names)
    curved = hand.curves.take(rows)
    gains = np.eye(6 + m, 6 + n)
    gains[6:, 6:] = matrix[[names.index(name) for name in columns]]
    order = np.array([sorted_joints.index(name) for name in columns], dtype=np.int64)
    on_curve = curved.curved[order]
    # The slope of a curve is part of the axis.
    gains[6:, 6:][on_curve] = np.eye(n)[curved.leader[order[on_curve]]]
    slope_offset = np.where(curved.curved, matrix[rows, curved.leader], 1.0)
    has_curves = bool(curved.curved.any())

    is_slide = {name: hand.joints_by_name[name].kind == "prismatic" for name in columns}
    slide = np.array([is_slide[name] for name in sorted_joints], dtype=bool)[:, None, None]
    T_zero = np.array([T_parent_joint[name] for name in sorted_joints]).reshape(m, 4, 4)
    turn_cos, turn_sin, shift = np.diag([1.0, 1.0, 0.0, 0.0]), np.zeros((4, 4)), np.zeros((4, 4))
    turn_sin[1, 0], turn_sin[0, 1], shift[2, 3] = 1.0, -1.0, 1.0

    follows = np.zeros((len(links) + m, 6 + m))
    follows[:, :6] = 1.0
    for row, name in enumerate([*(carrier[link][0] for link in links), *columns]):
        while name is not None:
            follows[row, 6 + columns.index(name)] = 1.0
            name = parent[name]

    root_twist, hinge_twist, slide_twist = _twist_forms()
    return tuple(columns), Numbers(
        values_matrix=matrix[rows].T,
        values_offset=offset[rows],
        T_constant=T_zero @ np.where(slide, np.eye(4), np.eye(4) - turn_cos),
        T_cos=T_zero @ np.where(slide, 0.0, turn_cos),
        T_sin=T_zero @ np.where(slide, 0.0, turn_sin),
        T_value=T_zero @ np.where(slide, shift, 0.0),
        levels=tuple(
            (_selection([above.index(parent[name]) for name in level]), slice(int(start), int(end)))
            for above, level, start, end in zip(levels[:-1], levels[1:], ends[:-1], ends[1:], strict=True)
        ),
        link_frames=_selection([frames.index(carrier[link][0]) for link in links]),
        T_frame_link=np.array([carrier[link][1] for link in links]).reshape(-1, 4, 4),
        joint_frames=_selection([frames.index(name) for name in columns]),
        root_twist=root_twist,
        hinge_twist=hinge_twist,
        slide_twist=slide_twist,
        slides=np.array([[is_slide[name]] for name in columns]) if slide.any() else None,
        leaders=curved.leader if has_curves else None,
        slope_offset=slope_offset if has_curves else None,
        higher=curved.higher if has_curves else None,
        column_order=order if has_curves else None,
        gains=None if np.array_equal(gains, np.eye(6 + n)) else gains,
        follows=follows,
    )


def _curved(xp: ModuleType, x: Array, slope_offset: Array, higher: Array) -> tuple[Array, Array]:
    """Values (batch, m) of the higher powers of x, by Horner's rule, and slopes (batch, m) with the linear part."""
    value, slope = xp.zeros_like(x), xp.zeros_like(x)
    for power in range(higher.shape[1] + 1, 1, -1):
        coefficient = higher[:, power - 2]
        value = (value + coefficient) * x
        slope = (slope + power * coefficient) * x
    return value * x, slope + slope_offset


def _twist_forms() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """`root_twist`, `hinge_twist` and `slide_twist` of the constants, from p x z = sum of e_ijk p_j z_k."""
    epsilon = np.zeros((3, 3, 3))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        epsilon[i, j, k], epsilon[i, k, j] = 1.0, -1.0
    hinge, slide, root = np.zeros((4, 4, 6)), np.zeros((4, 4, 6)), np.zeros((4, 6, 6))
    hinge[:3, :3, :3] = epsilon.transpose(1, 2, 0)
    hinge[3, :3, 3:] = slide[3, :3, :3] = root[3, :3, :3] = np.eye(3)
    root[:, 3:] = hinge[:, :3]
    return root.reshape(4, 36), hinge.reshape(16, 6), slide.reshape(16, 6)


def _selection(places: list[int]) -> Selection:
    """The indices as a slice if they are consecutive, else as an array."""
    if places and places == list(range(places[0], places[0] + len(places))):
        return slice(places[0], places[0] + len(places))
    return np.array(places, dtype=np.int64)
