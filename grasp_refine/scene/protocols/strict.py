"""Protocol of DexGraspBench with less friction.

Source: our own. Half of the sliding friction, and a tenth of the torsional friction, distinguish grasps of which nearly
all hold under the protocol of DexGraspBench.
"""

from grasp_refine.scene.protocols.protocol import Protocol

STRICT = Protocol(name="strict", friction=0.3, torsion=0.002)
