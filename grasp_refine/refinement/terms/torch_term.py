"""Term of a function of torch tensors."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from grasp_refine.core.arguments import check_kind, describe_value
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.se3 import Array
from grasp_refine.refinement.terms.term import State, Term
from grasp_refine.scene.scene import Scene

if TYPE_CHECKING:
    from torch import Tensor


class TorchTerm(Term):
    """Residuals that a function of tensors returns: a loss in torch, for every solver.

    def high(state, scene):
        return (0.15 - state.T[:, 2, 3]).clamp(min=0)   # metres, of M grasps

    gr.refine(hand, mug, grasps, terms=[gr.TorchTerm(high, weight=10.0)])
    """

    def __init__(self, function: Callable[[State, Scene], Tensor], weight: float = 1.0) -> None:
        """Make the term.

        Args:
            function: Returns residuals (M,) or (M, R), given the state of M grasps in tensors, and the scene. The loss
                is the sum of their squares; its gradients flow through `state.T`, `state.q`, `state.T_link` and the
                witness points of links and object, `state.witness`.
            weight: Factor of the loss.

        Raises:
            GraspRefineError: no function, or a weight that is negative or not finite.
        """
        check_kind("TorchTerm: function", function, Callable)
        check_kind("TorchTerm: weight", weight, float)
        self.function, self.weight = function, weight

    def residuals(self, state: State) -> tuple[Array, ...]:
        """Return what the function returns, in the library of the state.

        Raises:
            GraspRefineError: it returns no tensor (M, ...).
        """
        import torch

        in_numpy = isinstance(state.q, np.ndarray)
        found = self.function(_in_tensors(state) if in_numpy else state, self.setup.scene)
        if not (isinstance(found, torch.Tensor) and found.shape[:1] == (len(state.member),)):
            name = getattr(self.function, "__name__", "its function")
            raise GraspRefineError(
                f"TorchTerm: {name} must return a tensor of shape ({len(state.member)}, ...), got "
                f"{describe_value(found)}"
            )
        return (found.detach().double().cpu().numpy() if in_numpy else found,)


def _in_tensors(state: State) -> State:
    """Return a state in tensors without a graph."""
    import torch

    names = ("point_a", "point_b", "normal", "distance")
    tensors: dict[str, Any] = {name: torch.as_tensor(getattr(state.witness, name)) for name in names}
    witness = replace(state.witness, **tensors)
    T, q, T_link = (torch.as_tensor(part) for part in (state.T, state.q, state.T_link))
    return replace(state, T=T, q=q, T_link=T_link, witness=witness)
