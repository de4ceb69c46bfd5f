"""Forward kinematics of a hand for autograd: poses of its links as a function of root pose and joint values.

For losses of first-order solvers and of one's own; whatever needs no gradient by autograd uses `chain.Chain`, which
takes a seventh of the time on one grasp and comes without torch. pytorch-kinematics computes the poses here. Its chain
is built from the parsed hand and not from a URDF file, because its own reader rounds rotations to single precision,
ignores mimic joints and has a joint order of its own; ours is `hand.joint_names`, and mimic joints are expanded before
it is called.
"""

from collections.abc import Sequence

import numpy as np
import torch
from pytorch_kinematics import Transform3d
from pytorch_kinematics.chain import Chain
from pytorch_kinematics.frame import Frame, Joint, Link
from torch import Tensor

from grasp_refine.core.arguments import as_numbers, check_kind, check_shape
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.profiling import stage
from grasp_refine.hands.hand import Hand


class Kinematics:
    """Poses of chosen links of a hand as a differentiable function of root pose and joint values."""

    def __init__(
        self,
        hand: Hand,
        links: Sequence[str],
        *,
        dtype: torch.dtype = torch.float64,
        device: torch.device | str = "cpu",
    ) -> None:
        """Prepare the chain down to `links`; frames that lead to none of them are not computed.

        Raises:
            HandError: the hand has no link of such a name.
            GraspRefineError: an argument of another kind, or a device that torch does not have.
        """
        check_kind("hand", hand, Hand)
        check_kind("links", tuple(links) if isinstance(links, list) else links, tuple[str, ...])
        check_kind("dtype", dtype, torch.dtype)
        try:
            torch.empty(0, device=device)
        except (RuntimeError, TypeError, AssertionError) as error:
            raise GraspRefineError(f"device {device} cannot be used: {str(error).partition(chr(10))[0]}") from None
        frames = {hand.base_link: Frame(hand.base_link)}
        for joint in hand.joints_to(links):
            offset = Transform3d(matrix=torch.as_tensor(joint.T_parent_child, dtype=torch.float64))
            kind = "revolute" if joint.kind == "continuous" else joint.kind
            axis = None if kind == "fixed" else torch.as_tensor(joint.axis, dtype=torch.float64)
            frame = Frame(
                joint.child,
                Link(joint.child),
                Joint(joint.name, offset, kind, axis, dtype=torch.float64, limits=(0, 0)),
            )
            frames[joint.child] = frame
            frames[joint.parent].add_child(frame)
        self.links, self._name = tuple(links), hand.name
        self._chain = Chain(frames[hand.base_link], dtype=torch.float64)
        order = self._chain.get_joint_parameter_names()
        matrix, offset, names = hand.mimic_map()
        rows = [names.index(name) for name in order]
        self._index = [self._chain.frame_to_idx[link] for link in links]
        self._matrix = torch.as_tensor(np.asarray(matrix)[rows].T, dtype=dtype, device=device)
        self._offset = torch.as_tensor(np.asarray(offset)[rows], dtype=dtype, device=device)
        curved = hand.curves.take(rows)
        self._leader = torch.as_tensor(curved.leader, device=device)
        self._higher = torch.as_tensor(curved.higher, dtype=dtype, device=device) if curved.curved.any() else None
        self._chain.to(dtype=dtype, device=device)

    @stage("kinematics")
    def __call__(self, T_world_root: Tensor, q: Tensor) -> Tensor:
        """Poses T_world_link (batch, links, 4, 4) of the chosen links, in their order.

        Args:
            T_world_root: Poses of the hand's base link (batch, 4, 4).
            q: Independent joint values (batch, n) in `hand.joint_names` order; radians, metres for prismatic joints.

        Raises:
            GraspRefineError: other shapes, or another device than that of the kinematics.
        """
        T_world_root, q = self._as_tensor("T_world_root", T_world_root), self._as_tensor("q", q)
        joints = f"one column for each joint in joint_names of hand '{self._name}'"
        check_shape("q", q, "batch", len(self._matrix), why=joints)
        check_shape("T_world_root", T_world_root, len(q), 4, 4, why="one transform for each row of q")
        values = q @ self._matrix + self._offset
        if self._higher is not None:
            x = q[:, self._leader]
            values = values + sum(c * x**power for power, c in enumerate(self._higher.T, 2))
        T_root_frame = self._chain.forward_kinematics_tensor(values)
        return T_world_root[:, None] @ T_root_frame[self._index].transpose(0, 1)

    def _as_tensor(self, name: str, value: Tensor) -> Tensor:
        """An argument as a tensor of the number type of the chain, on its graph if it has one."""
        if not isinstance(value, Tensor):
            value = torch.as_tensor(as_numbers(name, value), device=self._matrix.device)
        if value.device != self._matrix.device:
            raise GraspRefineError(f"{name} is on {value.device}, the kinematics are on {self._matrix.device}")
        return value.to(self._matrix.dtype)
