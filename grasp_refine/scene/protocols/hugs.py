"""Protocol of HUGS: an object that weighs more the larger it is, lifted off a table.

Source: HUGS-DexGraspBench, github.com/hugs-dex/HUGS-DexGraspBench, a descendant of DexGraspBench for grasps of objects
of any size. `config/task/eval.yaml`: friction 0.8 and 0.02, density 700 kg/m^3 at scale 0.06, to the power -2 of the
scale, at most 0.5 kg; 10 mm, 5 cm and 15 degrees. `src/task/eval_func/tabletop_mocap.py`: gravity of 10 m/s^2, one
second each to close, squeeze and lift; `src/task/eval_func/base.py`: a lift of 10 cm. No text of a paper about it was
found; these numbers are the configuration's.

Differences: its scale is a factor of meshes whose bounding box has a diagonal of 2, as the examples of DexGraspBench
have, so that it is half of the diagonal here. The volume is that of the convex pieces instead of the mesh. The object
must stay near where the hand would carry it at each of five checks instead of at the end. Two hands are not simulated.
"""

from grasp_refine.scene.protocols.protocol import Protocol

HUGS = Protocol(
    name="hugs",
    friction=0.8,
    density=700.0,
    density_size=0.06,
    largest_mass=0.5,
    directions=(),
    acceleration=10.0,
    moves=25,
    checks=5,
)
