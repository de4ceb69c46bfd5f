"""Minimise the loss by a solver of your own: here RMSProp, gradients over the roots of their averaged squares.

Any class with the members of `gr.Solver` is a solver; `gr.FirstOrder` has all but the direction of a step.
"""

from dataclasses import dataclass

import numpy as np
import torch

import grasp_refine as gr


@dataclass(frozen=True)
class RMSProp(gr.FirstOrder):
    """Steps of about the same length in each unknown; lengths shrink as `FirstOrder` says."""

    iterations: int = 300
    decay: float = 0.9

    def initial_memory(self, count: int, dof: int) -> np.ndarray:
        return np.zeros((count, dof))  # averaged squares of each grasp

    def direction(self, gradient: torch.Tensor, memory: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        squares = self.decay * memory + (1.0 - self.decay) * gradient.square()
        return gradient / (squares.sqrt() + 1e-12), squares


hand, box = gr.load_hand("allegro"), gr.load_object("box:0.06,0.05,0.09")
grasps = gr.sample_grasps(hand, box, 2, seed=1)
noise = np.random.default_rng(0).normal(0.0, 0.1, grasps.q.shape)  # radians
off = gr.GraspSet.of(hand, grasps.hand_pose, grasps.q + noise, object=box.name)

weights = gr.Weights(penetration=10.0, self_penetration=10.0)  # with which gradients are faster
refined = gr.refine(hand, box, off, gr.Config(solver=RMSProp(), weights=weights, tolerance=1e-6))
print(refined)
