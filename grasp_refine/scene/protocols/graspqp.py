"""Protocol of GraspQP: half of the pushes must be held.

Source: Zurbrügg, Cramariuc and Hutter, "GraspQP: Differentiable Optimization of Force Closure for Diverse and Robust
Dexterous Grasping", CoRL 2025 (arXiv 2508.15002), by its code, github.com/leggedrobotics/graspqp, in
`graspqp_isaaclab/src/graspqp_isaaclab`. `tasks/manipulation/grasp/grasp_mining_env.py`: no gravity, friction 1.0, 3 N
for half a second in each of six directions, and an object that is lost once it is 3 cm away;
`tasks/manipulation/grasp/config/object_mining_env.py`: 0.2 kg; `agents/eval.py`: a grasp that does not fail in at least
half of the trials is a success. The text of the paper was not available.

Differences: there, the pushes of an axis follow each other, a trial succeeds if the object stays along any of three
axes, and trials repeat; here the trials are the six pushes, each from the same state; three must be held.
PhysX has another contact model, and no torsional friction. Here torsional friction, the motion of the hand, the
contacts and the largest penetration are as in DexGraspBench. No rotation is a failure, as there; checks are 0.1 instead
of 0.33 s apart.
"""

from math import tau

from grasp_refine.scene.protocols.protocol import Protocol

GRASPQP = Protocol(
    name="graspqp",
    friction=1.0,
    mass=0.2,
    acceleration=15.0,
    required_share=0.5,
    checks=5,
    steps_per_check=25,
    farthest=0.03,
    # A rotation is at most half a turn.
    steepest=tau,
)
