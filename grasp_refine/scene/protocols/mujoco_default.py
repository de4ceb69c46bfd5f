"""Protocol of DexGraspBench in the contacts of a model that says nothing about them.

Source: our own. Pyramidal cone, impratio 1 and no noslip iterations are MuJoCo's defaults (its XML reference,
`option`). There loaded contacts creep, so that objects are lost which friction holds: figures are in
`docs/pages/guides/validate.md`. Verdicts in it are of the many models that keep the defaults, not of the grasp alone.
"""

from grasp_refine.scene.protocols.contact_model import MUJOCO_CONTACT
from grasp_refine.scene.protocols.protocol import Protocol

MUJOCO_DEFAULT = Protocol(name="mujoco-default", contact=MUJOCO_CONTACT)
