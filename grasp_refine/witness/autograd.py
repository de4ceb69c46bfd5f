"""The witness layer: poses in, witness points out, inside any torch graph.

The forward pass returns the values of the collision query; the backward pass contracts the Jacobian of a derivative
method with the incoming gradients. This file has the only autograd.Function of the layer.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np
import torch
from torch import Tensor

from grasp_refine.collision.query import Pairs, Witness, check_poses, query
from grasp_refine.core.arguments import as_numbers, check_kind
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.profiling import stage
from grasp_refine.core.se3 import ambient_gradient
from grasp_refine.witness.derivative import Derivative, PoseGradients
from grasp_refine.witness.neighborhood import Surfaces
from grasp_refine.witness.scene import WitnessScene
from grasp_refine.witness.slip import wrench


class WitnessLayer:
    """Differentiable witness points of body pairs.

    Exact: the signed distance's gradient, d' = n . (V_b(x_b) - V_a(x_a)), wherever the witness pair is unique; it
    needs no smoothing. Approximated, by `method`: the slip of points and normals along the surfaces. Poses get first
    derivatives only: a second one through the layer (double backward, a Hessian) is a GraspRefineError.
    """

    def __init__(self, pairs: Pairs, method: Derivative) -> None:
        """Prepare the pairs; `method` is used in backward passes only.

        Raises:
            GraspRefineError: an argument of another type.
        """
        check_kind("pairs", pairs, Pairs)
        check_kind("method", method, Derivative)
        self.pairs = pairs
        self.method = method
        self._in_one_call = method if isinstance(method, PoseGradients) else None
        self._columns: dict[bytes, tuple[Pairs, Surfaces]] = {}

    def __call__(
        self,
        T_world_a: Tensor,
        T_world_b: Tensor,
        target_a: Tensor | None = None,
        target_b: Tensor | None = None,
        *,
        cutoff: np.ndarray | float = np.inf,
        key: int = 0,
        previous: Witness | None = None,
    ) -> Witness:
        """Query the witness points of all pairs, as tensors with gradients to the poses.

        Args:
            T_world_a: Poses of the first bodies (batch, P, 4, 4).
            T_world_b: Poses of the second bodies (batch, P, 4, 4).
            target_a: Target points (batch, P, 3) of the first bodies, body frames, metres; NaN: none. Targets only
                set the width of adaptive neighbourhoods.
            target_b: Target points of the second bodies.
            cutoff: Distance (metres; one number or one per pair) beyond which pairs are not queried.
            key: Iteration number, for methods that draw samples.
            previous: The answer at nearby poses, which saves work (see `collision.query.query`).

        Returns:
            Witness points, normals and signed distances in the dtype and on the device of `T_world_a`.

        Raises:
            GraspRefineError: poses or targets of another shape, or not numeric.
        """
        # A call of one pair takes some ten microseconds: no check here may cost as much.
        if type(key) is not int:
            check_kind("key", key, int)
        if previous is not None:
            check_kind("previous", previous, Witness)
        T_world_a, T_world_b = _tensor("T_world_a", T_world_a), _tensor("T_world_b", T_world_b)
        check_poses(len(self.pairs), T_world_a, T_world_b, previous)
        lead = T_world_a.shape[:2]
        targets = (
            None if target_a is None else as_numbers("target_a", target_a, *lead, 3),
            None if target_b is None else as_numbers("target_b", target_b, *lead, 3),
        )
        found = self.find(_array(T_world_a), _array(T_world_b), targets, cutoff, previous)
        return self.known(T_world_a, T_world_b, found, *targets, key=key)

    def known(
        self,
        T_world_a: Tensor,
        T_world_b: Tensor,
        found: Witness,
        target_a: np.ndarray | None = None,
        target_b: np.ndarray | None = None,
        *,
        key: int = 0,
    ) -> Witness:
        """Return witness points that are known at these poses, in NumPy arrays, as tensors with gradients to the poses.

        Arguments and result are otherwise as in the call, which finds the points first.
        """
        x_a, x_b, n, d = _WitnessFunction.apply(T_world_a, T_world_b, self, found, target_a, target_b, key)
        return Witness(x_a, x_b, n, d, found.status, found.winner, found.num_queries)

    def find(
        self,
        T_a: np.ndarray,
        T_b: np.ndarray,
        targets: tuple[np.ndarray | None, ...],
        cutoff: np.ndarray | float,
        previous: Witness | None,
    ) -> Witness:
        """Return the witness of all pairs as arrays; a subclass may choose other points, which slip by the method."""
        return query(self.pairs, T_a, T_b, cutoff=cutoff, previous=previous)

    @cached_property
    def surfaces(self) -> Surfaces:
        """Candidates of the first and then the second bodies."""
        return Surfaces.of((*self.pairs.a, *self.pairs.b))

    def columns(self, columns: np.ndarray) -> tuple[Pairs, Surfaces]:
        """Return the pairs `columns`, and the candidates of their first and then their second bodies; built once."""
        if len(columns) == len(self.pairs):
            return self.pairs, self.surfaces
        name = columns.tobytes()
        if name not in self._columns:
            pairs = self.pairs.take(columns)
            self._columns[name] = pairs, Surfaces.of((*pairs.a, *pairs.b))
        return self._columns[name]

    def pose_gradients(
        self,
        T_a: np.ndarray,
        T_b: np.ndarray,
        found: Witness,
        targets: tuple[np.ndarray | None, np.ndarray | None],
        key: int,
        cotangents: Sequence[np.ndarray | None],
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the gradients (batch, P, 4, 4) in both poses, from those in points, normals and distances."""
        if self._in_one_call is not None:
            scene = WitnessScene(self.pairs, self.surfaces, T_a, T_b, found, *targets, key)
            if (gradients := self._in_one_call.pose_gradients(scene, cotangents)) is not None:
                return gradients
        return _pull_back(self, T_a, T_b, found, targets, key, cotangents)


class _WitnessFunction(torch.autograd.Function):
    """Identity on the values; the backward pass is the transpose of the method's Jacobian."""

    @staticmethod
    def forward(  # noqa: D102, PLR0913
        ctx: Any,
        T_a: Tensor,
        T_b: Tensor,
        layer: WitnessLayer,
        found: Witness,
        target_a: np.ndarray | None,
        target_b: np.ndarray | None,
        key: int,
    ) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        ctx.set_materialize_grads(False)
        ctx.save_for_backward(T_a, T_b)
        ctx.layer, ctx.found, ctx.targets, ctx.key = layer, found, (target_a, target_b), key
        ctx.poses = _array(T_a), _array(T_b)
        return (
            _like(T_a, found.point_a),
            _like(T_a, found.point_b),
            _like(T_a, found.normal),
            _like(T_a, found.distance),
        )

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor | None) -> tuple[Tensor | None, ...]:  # noqa: D102
        if not torch.is_grad_enabled():
            return *_WitnessFunction._to_poses(ctx, gradients), None, None, None, None, None
        with torch.no_grad():
            found = _WitnessFunction._to_poses(ctx, gradients)
        # For create_graph=True: without an edge, torch would say that the poses were not used at all.
        edges = *ctx.saved_tensors, *(gradient for gradient in gradients if gradient is not None)
        refusing = tuple(None if part is None else _NoSecondDerivative.apply(part, *edges) for part in found)
        return *refusing, None, None, None, None, None

    @staticmethod
    @stage("derivative")
    def _to_poses(ctx: Any, gradients: tuple[Tensor | None, ...]) -> tuple[Tensor | None, Tensor | None]:
        """Gradients of both poses; None where one needs none."""
        T_a, T_b = ctx.saved_tensors
        cotangents = [None if gradient is None else _array(gradient) for gradient in gradients]
        G_a, G_b = ctx.layer.pose_gradients(*ctx.poses, ctx.found, ctx.targets, ctx.key, cotangents)
        need_a, need_b = ctx.needs_input_grad[:2]
        return _like(T_a, G_a) if need_a else None, _like(T_b, G_b) if need_b else None


class _NoSecondDerivative(torch.autograd.Function):
    """Identity on a gradient that refuses to be differentiated."""

    @staticmethod
    def forward(ctx: Any, gradient: Tensor, *edges: Tensor) -> Tensor:  # noqa: D102
        return gradient.clone()

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> Any:  # noqa: D102
        raise GraspRefineError(
            "WitnessLayer has first derivatives only: differentiate its outputs once, without a Hessian or a gradient "
            "penalty through it, or take finite differences of its gradients"
        )


def _pull_back(
    layer: WitnessLayer,
    T_a: np.ndarray,
    T_b: np.ndarray,
    found: Witness,
    targets: tuple[np.ndarray | None, np.ndarray | None],
    key: int,
    cotangents: Sequence[np.ndarray | None],
) -> tuple[np.ndarray, np.ndarray]:
    """`WitnessLayer.pose_gradients` of any method, which gives wrenches on the bodies."""
    poses, valid = np.stack([T_a, T_b]), None
    if not found.valid.all():
        # Placeholder values keep the arithmetic finite; these pairs have no cotangents.
        valid = found.valid[..., None]
        poses = np.where(valid[..., None], poses, np.eye(4))
        normal = np.where(valid, found.normal, [0.0, 0.0, 1.0])
        found = replace(found, normal=normal, distance=np.where(found.valid, found.distance, 1.0))
    g_a, g_b, g_n, g_d = (
        g if g is None or valid is None else np.where(valid if g.ndim == 3 else valid[..., 0], g, 0.0)
        for g in cotangents
    )
    wrenches = np.zeros((2, *found.distance.shape, 6))
    if g_d is not None:
        # Both witness points lie on the line of the normal, so the bodies get equal and opposite wrenches.
        wrenches[1] = wrench(found.point_b, g_d[..., None] * found.normal)
        wrenches[0] = -wrenches[1]
    moving = [g for g in (g_a, g_b, g_n) if g is not None]
    if moving:
        # The derivative is computed only for pairs with nonzero cotangents.
        columns = np.flatnonzero(np.logical_or.reduce([g.any(axis=(0, 2)) for g in moving]))
        if len(columns):
            index = slice(None) if len(columns) == found.distance.shape[1] else columns
            pairs, surfaces = layer.columns(columns)
            some = found.pairs(index)
            if pairs is not layer.pairs:
                # Winners are relative to the first piece pair of their body pair.
                shift = pairs.first_piece_pair - layer.pairs.first_piece_pair[columns]
                some = replace(some, winner=np.where(some.winner >= 0, some.winner + shift, -1))
            zero = np.zeros_like(some.point_a)
            force_a, force_b = (zero if g is None else g[:, index] for g in (g_a, g_b))
            target_a, target_b = (None if target is None else target[:, index] for target in targets)
            scene = WitnessScene(pairs, surfaces, poses[0][:, index], poses[1][:, index], some, target_a, target_b, key)
            extra = layer.method.pull_back(scene, force_a, force_b, None if g_n is None else g_n[:, index])
            wrenches[0][:, index] += extra[0]
            wrenches[1][:, index] += extra[1]
    moved = ambient_gradient(poses, wrenches)
    return moved[0], moved[1]


def _array(tensor: Tensor) -> np.ndarray:
    if tensor.dtype is not torch.float64 or not tensor.is_cpu:
        tensor = tensor.to("cpu", torch.float64)
    return tensor.detach().numpy()


def _like(tensor: Tensor, array: np.ndarray) -> Tensor:
    """An array as a tensor, in the dtype and on the device of another."""
    made = torch.from_numpy(array)
    return made if tensor.dtype is torch.float64 and tensor.is_cpu else made.to(tensor.device, tensor.dtype)


def _tensor(name: str, poses: Tensor) -> Tensor:
    """Poses as a floating-point tensor; arrays and lists have no graph."""
    if isinstance(poses, Tensor) and poses.is_floating_point():
        return poses
    return torch.as_tensor(as_numbers(name, poses))
