"""Minimise the loss by a solver of your own: here gradient descent by the signs of the gradient."""

from dataclasses import dataclass

import numpy as np
import torch

import grasp_refine as gr


@dataclass(frozen=True)
class SignDescent(gr.FirstOrder):
    """Steps of fixed lengths against the signs of the gradient; lengths shrink as `FirstOrder` says."""

    iterations: int = 400

    def initial_memory(self, count: int, dof: int) -> np.ndarray:
        return np.zeros((count, 0))  # it remembers nothing

    def direction(self, gradient: torch.Tensor, memory: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        return gradient.sign(), memory


hand, box = gr.load_hand("allegro"), gr.load_object("box:0.06,0.05,0.09")
grasps = gr.sample_grasps(hand, box, 2, seed=1)
drawn = np.random.default_rng(0).normal(0.0, 0.1, grasps.q.shape)
off = gr.GraspSet.of(hand, grasps.hand_pose, grasps.q + drawn, object=box.name)

refined = gr.refine(hand, box, off, gr.Config(solver=SignDescent(), tolerance=1e-6))
print(refined)
