"""Protocol of DexGraspBench.

Source: Chen et al., "BODex: Scalable and Efficient Robotic Dexterous Grasp Synthesis Using Bilevel Optimization", ICRA
2025 (arXiv 2412.16490), and its benchmark, github.com/JYChen18/DexGraspBench: `config/task/eval.yaml` (friction, mass,
limits), `src/util/hand_util.py` (contacts, weld of the palm) and `src/task/eval_func/fc_mocap.py` (motion, six
pushes).

Differences: verdicts against the benchmark's own are in `docs/pages/benchmarks.md`. A lost object is noticed at each of
ten checks of a push, as there; the hand is ours, from URDF or MJCF.
"""

from grasp_refine.scene.protocols.protocol import Protocol

DEXGRASPBENCH = Protocol(palm="soft weld")
