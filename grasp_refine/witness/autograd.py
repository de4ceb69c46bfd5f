"""The witness layer: poses in, witness points out, inside any torch graph.

The forward pass returns the values of the collision query; the backward pass contracts the Jacobian of a derivative
method with the incoming gradients. This file has the only autograd.Function of the layer.
"""

from dataclasses import replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from grasp_refine.collision.query import Pairs, Witness, check_poses, query
from grasp_refine.core.arguments import as_numbers, check_kind
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.profiling import stage
from grasp_refine.core.se3 import ambient_gradient
from grasp_refine.witness.derivative import Derivative
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
        check_kind("key", key, int)
        check_kind("previous", previous, Witness | None)
        T_world_a, T_world_b = _tensor("T_world_a", T_world_a), _tensor("T_world_b", T_world_b)
        check_poses(len(self.pairs), T_world_a, T_world_b, previous)
        lead = T_world_a.shape[:2]
        targets = tuple(
            None if target is None else as_numbers(name, target, *lead, 3)
            for name, target in (("target_a", target_a), ("target_b", target_b))
        )
        T_a, T_b = _array(T_world_a), _array(T_world_b)
        found = self.find(T_a, T_b, targets, cutoff, previous)
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

    def columns(self, columns: np.ndarray) -> tuple[Pairs, Surfaces]:
        """Return the pairs `columns`, and the candidates of their first and then their second bodies; built once."""
        name = columns.tobytes()
        if name not in self._columns:
            pairs = self.pairs if len(columns) == len(self.pairs) else self.pairs.take(columns)
            self._columns[name] = pairs, Surfaces.of((*pairs.a, *pairs.b))
        return self._columns[name]


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
        x_a, x_b, n, d = (
            torch.as_tensor(array, dtype=T_a.dtype, device=T_a.device)
            for array in (found.point_a, found.point_b, found.normal, found.distance)
        )
        return x_a, x_b, n, d

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor | None) -> tuple[Tensor | None, ...]:  # noqa: D102
        with torch.no_grad():
            found: tuple[Tensor | None, ...] = _WitnessFunction._pull_back(ctx, *gradients)
        if torch.is_grad_enabled():
            # For create_graph=True: without an edge, torch would say that the poses were not used at all.
            edges = *ctx.saved_tensors, *(gradient for gradient in gradients if gradient is not None)
            found = tuple(None if part is None else _NoSecondDerivative.apply(part, *edges) for part in found)
        return *found, None, None, None, None, None

    @staticmethod
    @stage("derivative")
    def _pull_back(
        ctx: Any,
        grad_a: Tensor | None,
        grad_b: Tensor | None,
        grad_normal: Tensor | None,
        grad_distance: Tensor | None,
    ) -> tuple[Tensor | None, Tensor | None]:
        """Gradients of both poses; None where one needs none."""
        tensor_a, tensor_b = ctx.saved_tensors
        poses = np.stack([_array(tensor_a), _array(tensor_b)])
        found, valid = ctx.found, None
        if not found.valid.all():
            # Placeholder values keep the arithmetic finite; these pairs have no cotangents.
            valid = found.valid[..., None]
            poses = np.where(valid[..., None], poses, np.eye(4))
            normal = np.where(valid, found.normal, [0.0, 0.0, 1.0])
            found = replace(found, normal=normal, distance=np.where(found.valid, found.distance, 1.0))
        g_a, g_b, g_n = (_cotangent(g, valid) for g in (grad_a, grad_b, grad_normal))
        wrenches = np.zeros((2, *found.distance.shape, 6))
        if grad_distance is not None:
            # Both witness points lie on the line of the normal, so the bodies get equal and opposite wrenches.
            wrenches[1] = wrench(found.point_b, _cotangent(grad_distance[..., None], valid) * found.normal)
            wrenches[0] = -wrenches[1]
        gradients = [g for g in (g_a, g_b, g_n) if g is not None]
        if gradients:
            # The derivative is computed only for pairs with nonzero cotangents.
            columns = np.flatnonzero(np.logical_or.reduce([g.any(axis=(0, 2)) for g in gradients]))
            if len(columns):
                index = slice(None) if len(columns) == found.distance.shape[1] else columns
                extra = _pull_back_points(ctx, found, columns, index, g_a, g_b, g_n, *poses)
                wrenches[0][:, index] += extra[0]
                wrenches[1][:, index] += extra[1]
        moved = ambient_gradient(poses, wrenches)
        gradient = torch.as_tensor(moved, dtype=tensor_a.dtype, device=tensor_a.device)
        need_a, need_b = ctx.needs_input_grad[:2]
        return gradient[0] if need_a else None, gradient[1] if need_b else None


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


def _pull_back_points(
    ctx: Any,
    found: Witness,
    columns: np.ndarray,
    index: np.ndarray | slice,
    g_a: np.ndarray | None,
    g_b: np.ndarray | None,
    g_n: np.ndarray | None,
    T_a: np.ndarray,
    T_b: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Wrenches on the bodies from covectors on points and normals, for the pairs `columns`, selected by `index`."""
    layer: WitnessLayer = ctx.layer
    pairs, surfaces = layer.columns(columns)
    found = found.pairs(index)
    if pairs is not layer.pairs:
        # Winners are relative to the first piece pair of their body pair.
        shift = pairs.first_piece_pair - layer.pairs.first_piece_pair[columns]
        found = replace(found, winner=np.where(found.winner >= 0, found.winner + shift, -1))
    zero = np.zeros_like(found.point_a)
    g_a, g_b = (zero if g is None else g[:, index] for g in (g_a, g_b))
    target_a, target_b = (None if target is None else target[:, index] for target in ctx.targets)
    scene = WitnessScene(pairs, surfaces, T_a[:, index], T_b[:, index], found, target_a, target_b, ctx.key)
    return layer.method.pull_back(scene, g_a, g_b, None if g_n is None else g_n[:, index])


def _cotangent(gradient: Tensor | None, valid: np.ndarray | None) -> np.ndarray | None:
    """Incoming gradient as an array, zero where there are no witness points (`valid` None: all pairs have them)."""
    if gradient is None or valid is None:
        return None if gradient is None else _array(gradient)
    return np.where(valid, _array(gradient), 0.0)


def _array(tensor: Tensor) -> np.ndarray:
    return tensor.detach().to("cpu", torch.float64).numpy()


def _tensor(name: str, poses: Tensor) -> Tensor:
    """Poses as a floating-point tensor; arrays and lists have no graph."""
    if isinstance(poses, Tensor) and poses.is_floating_point():
        return poses
    return torch.as_tensor(as_numbers(name, poses))
