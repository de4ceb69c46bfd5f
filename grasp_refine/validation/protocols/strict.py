"""Protocol of DexGraspBench with less friction.

Source: our own. Half of the sliding friction, and a tenth of the torsional friction, tell grasps apart of which nearly
all hold under the protocol of DexGraspBench.
"""

from dataclasses import replace

from grasp_refine.validation.protocols.dexgraspbench import DEXGRASPBENCH

STRICT = replace(DEXGRASPBENCH, name="strict", friction=0.3, torsion=0.002)
