"""Protocol of DexGraspNet in Isaac Gym: gravity in six directions; all must be held.

Source: Wang et al., "DexGraspNet: A Large-Scale Robotic Dexterous Grasp Dataset for General Objects Based on
Simulation", ICRA 2023 (arXiv 2210.02697), by its code, github.com/PKU-EPIC/DexGraspNet, in `grasp_generation`.
`utils/isaac_validator.py`: friction 3 of hand and object, 500 kg/m^3, gravity of 9.8 m/s^2, 100 steps of 1/60 s, six
orientations of hand and object against gravity; `scripts/validate_grasps.py`: all six must be held. The validation of
GraspQP in Isaac Lab, whose engine is PhysX too, is the protocol `graspqp`.

Differences: there, a grasp is held if hand and object touch at the end; here the object is lost once it is 10 cm away,
a limit that the class there has, and does not use. There, servos of 1000 N m/rad hold set points that a step along the
gradient brought 1 mm into the object, and the hand starts at the grasp; here motion, servos and squeeze are those of
the hand. There, penetrations of the points of the hand must not exceed 1 mm in all; here the largest penetration is
that of DexGraspBench. The mass is that of the convex pieces in both. PhysX has no torsional friction with a hand, so
that it is 0 here; simulate in engine `physx` for its contacts. The time step is 4 instead of 8.3 ms.
"""

from math import tau

from grasp_refine.scene.protocols.protocol import Protocol

ISAACGYM = Protocol(
    name="isaacgym",
    friction=3.0,
    torsion=0.0,
    density=500.0,
    acceleration=9.8,
    checks=8,
    # 1.664 s in all.
    steps_per_check=52,
    farthest=0.1,
    # A rotation is at most half a turn.
    steepest=tau,
)
