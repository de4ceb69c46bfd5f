"""Add a term to the loss, with rows of its Jacobian: here some joints stay near a comfortable value.

With rows, Levenberg-Marquardt needs no autograd. `check_term` compares them with finite differences.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

import grasp_refine as gr


@dataclass(frozen=True)
class Comfortable(gr.Term):
    """Distances of some joints from a comfortable value, in radians."""

    joints: tuple[str, ...]
    value: float = 0.0  # radians
    weight: float = 1e-3  # m^2 / rad^2

    def residuals(self, state: gr.State) -> tuple[np.ndarray, ...]:
        return (state.q[:, self.columns] - self.value,)  # (M, J)

    def rows(self, state: gr.State, width: np.ndarray) -> Iterator[gr.JointRows]:
        (residual,) = self.residuals(state)
        jacobian = np.zeros((*residual.shape, 6 + state.q.shape[1]))  # twist of the base link, then joints
        for row, column in enumerate(self.columns):
            jacobian[:, row, 6 + column] = 1.0
        yield gr.JointRows(residual, jacobian)

    @property
    def columns(self) -> list[int]:
        names = self.setup.scene.hand.joint_names
        return [names.index(joint) for joint in self.joints]


hand, mug = gr.load_hand("allegro"), gr.load_object("mug")
grasps = gr.sample_grasps(hand, mug, 4, seed=0)
term = Comfortable(joints=hand.joint_names[:1])
errors = gr.check_term(term, hand, mug, grasps)
print(f"errors of its derivatives: at most {max(found.max() for found in errors.values()):.1e}")

plain = gr.refine(hand, mug, grasps)
refined = gr.refine(hand, mug, grasps, terms=[term])
for name, found in (("without", plain), ("with", refined)):
    print(f"{name} the term: {abs(found.after.q[:, 0]).mean():.3f} rad from it")
