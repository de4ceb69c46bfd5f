"""Protocol that lifts the object off a table.

Source: the tabletop setting of DexGraspBench, `src/task/eval_func/tabletop_mocap.py` of its repository
(github.com/JYChen18/DexGraspBench): a lift of 10 cm.

Differences: gravity is 9.81 instead of 10 m/s^2. The lift takes 2 instead of 0.4 s, and the object must stay near where
the hand would carry it at each of ten checks instead of at the end.
"""

from grasp_refine.scene.protocols.protocol import Protocol

TABLETOP = Protocol(name="tabletop", directions=(), acceleration=9.81)
