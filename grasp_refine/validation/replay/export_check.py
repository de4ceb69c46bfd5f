"""Check that a model that was exported as XML has the physics of the original."""

from __future__ import annotations

import mujoco
import numpy as np

from grasp_refine.core.errors import GraspRefineError
from grasp_refine.validation.messages import unlogged

_PHYSICS = (
    *("body_parentid", "body_pos", "body_quat", "body_ipos", "body_iquat", "body_mass", "body_inertia"),
    *("body_gravcomp", "body_mocapid", "body_invweight0"),
    *("jnt_type", "jnt_pos", "jnt_axis", "jnt_limited", "jnt_range", "jnt_margin", "jnt_stiffness", "jnt_solref"),
    *("jnt_solimp", "jnt_actfrclimited", "jnt_actfrcrange", "jnt_stiffnesspoly", "jnt_actgravcomp"),
    *("qpos0", "qpos_spring", "dof_armature", "dof_damping", "dof_dampingpoly", "dof_frictionloss"),
    *("dof_solref", "dof_solimp", "dof_invweight0"),
    *("geom_type", "geom_bodyid", "geom_pos", "geom_size", "geom_contype", "geom_conaffinity", "geom_condim"),
    *("geom_friction", "geom_priority", "geom_solref", "geom_solimp", "geom_solmix", "geom_margin", "geom_gap"),
    *("geom_surfacevel", "geom_adhesion", "geom_fluid"),
    *("site_bodyid", "site_pos", "site_quat", "exclude_signature"),
    *("eq_type", "eq_obj1id", "eq_obj2id", "eq_active0", "eq_solref", "eq_solimp", "eq_data"),
    *("tendon_num", "wrap_type", "wrap_objid", "wrap_prm", "tendon_limited", "tendon_range", "tendon_margin"),
    *("tendon_stiffness", "tendon_damping", "tendon_frictionloss", "tendon_armature", "tendon_lengthspring"),
    *("tendon_stiffnesspoly", "tendon_dampingpoly", "tendon_solref_lim", "tendon_solimp_lim", "tendon_solref_fri"),
    *("tendon_solimp_fri", "tendon_actfrclimited", "tendon_actfrcrange"),
    *("actuator_trntype", "actuator_trnid", "actuator_gear", "actuator_dyntype", "actuator_dynprm"),
    *("actuator_gaintype", "actuator_gainprm", "actuator_biastype", "actuator_biasprm", "actuator_ctrllimited"),
    *("actuator_ctrlrange", "actuator_forcelimited", "actuator_forcerange", "actuator_damping", "actuator_armature"),
    "actuator_delay",
)
"""Arrays of a model that determine its motion, without those of meshes, whose frames may be chosen anew."""


def check_same_physics(model: mujoco.MjModel, text: str, added: str) -> None:
    """Refuse an exported model that does not move as the original; it costs a second compilation.

    Args:
        model: The original.
        text: XML of the exported model.
        added: Prefix of the names of actuators and sites that were added to the model, the actuators last.

    Raises:
        GraspRefineError: It does not, naming the array that differs; or it cannot be compiled.
    """
    try:
        with unlogged():
            written = mujoco.MjModel.from_xml_string(text)
    except ValueError as error:
        raise GraspRefineError(f"the exported model cannot be compiled: {error}") from None
    for name in _PHYSICS:
        ours = getattr(model, name, None)
        if ours is None:
            continue
        theirs = getattr(written, name)
        if name.startswith("actuator"):
            theirs = theirs[: len(ours)]
        if name.startswith("site"):
            # The added ones are among the others.
            theirs = theirs[[not written.site(i).name.startswith(added) for i in range(written.nsite)]]
        if name in ("geom_pos", "geom_size") and ours.shape == theirs.shape:
            solid = model.geom_type != mujoco.mjtGeom.mjGEOM_MESH
            ours, theirs = ours[solid], theirs[solid]
        if ours.shape != theirs.shape or not np.allclose(ours, theirs, rtol=1e-6, atol=1e-9):
            raise GraspRefineError(f"the model has something that is not exported: {name} would differ")
