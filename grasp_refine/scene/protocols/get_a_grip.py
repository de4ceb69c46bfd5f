"""Protocol of Get a Grip: labels between 0 and 1, the mean over objects that lie a little elsewhere.

Source: Lum et al., "Get a Grip: Multi-Finger Grasp Evaluation at Scale Enables Robust Sim-to-Real Transfer", CoRL 2024,
by its code, github.com/tylerlum/get_a_grip. In `get_a_grip/dataset_generation`, `utils/isaac_validator.py`: friction
0.9 of hand and object, 500 kg/m^3, gravity of 9.8 m/s^2, a lift of 20 cm in 2 s off a table, failure from 10 cm or 45
degrees on, offsets of up to 5 mm and 5 degrees; `scripts/eval_grasp_config_dict.py`: the label is the mean over the
offsets. `docs/dataset_generation.md`: 5 offsets.

Differences: labels stay labels there; grasps above 0.5 are taken as good ones to vary
(`scripts/augment_grasp_config_dicts.py`), grasps from 0.9 on to train the sampler (`docs/model_training.md`). Here a
grasp holds from 0.5 on. Offsets are uniform in a sphere instead of a cube, and on the table: shifts along it, turns
about its normal. Collisions are the largest penetration of DexGraspBench instead of a factor of the label. Not
required here: at least three touching links, and contact of allowed links only. PhysX has another contact model, and
its table a friction of 1.0.
"""

from math import radians

from grasp_refine.scene.protocols.noise import Noise
from grasp_refine.scene.protocols.protocol import Protocol

GET_A_GRIP = Protocol(
    name="get-a-grip",
    friction=0.9,
    density=500.0,
    directions=(),
    noise=Noise(count=5, offset=0.005, turn=radians(5)),
    required_label=0.5,
    acceleration=9.8,
    lift=0.2,
    farthest=0.1,
    steepest=radians(45),
)
