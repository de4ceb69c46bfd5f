"""Export of couplings and actuators of a model as XML: excludes, tendons, equalities, actuators."""

from __future__ import annotations

import xml.etree.ElementTree as ET

import mujoco
import numpy as np

from grasp_refine.core.errors import GraspRefineError
from grasp_refine.validation.replay.export_bodies import PUSH
from grasp_refine.validation.replay.export_values import flag_of, name_of, set_values, text_of

_DYNAMICS = ("none", "integrator", "filter", "filterexact")
_GAINS = ("fixed", "affine")
_BIASES = ("none", "affine")
"""Keywords of MuJoCo's XML by the numbers in its enumerations, which versions 3 and 4 share."""


def write_contacts(root: ET.Element, model: mujoco.MjModel) -> None:
    """Write the pairs of bodies that do not touch.

    Raises:
        GraspRefineError: The model has contact pairs.
    """
    if model.npair:
        raise GraspRefineError("explicit contact pairs are not exported")
    contact = ET.SubElement(root, "contact")
    for signature in model.exclude_signature:
        one, two = (name_of(model, "body", number) for number in (signature >> 16, signature & 0xFFFF))
        ET.SubElement(contact, "exclude", body1=one, body2=two)


def write_tendons(root: ET.Element, model: mujoco.MjModel) -> None:
    """Write all tendons.

    Raises:
        GraspRefineError: A tendon is not fixed.
    """
    tendons = ET.SubElement(root, "tendon")
    for tendon in range(model.ntendon):
        name = name_of(model, "tendon", tendon)
        wraps = range(model.tendon_adr[tendon], model.tendon_adr[tendon] + model.tendon_num[tendon])
        if any(model.wrap_type[wrap] != mujoco.mjtWrap.mjWRAP_JOINT for wrap in wraps):
            raise GraspRefineError(f"tendon {name}: only fixed tendons are exported")
        node = ET.SubElement(tendons, "fixed", name=name, limited=flag_of(model.tendon_limited[tendon]))
        values = {
            "margin": model.tendon_margin[tendon],
            "stiffness": model.tendon_stiffness[tendon],
            "damping": model.tendon_damping[tendon],
            "frictionloss": model.tendon_frictionloss[tendon],
            "springlength": model.tendon_lengthspring[tendon],
            "solreflimit": model.tendon_solref_lim[tendon],
            "solimplimit": model.tendon_solimp_lim[tendon],
            "solreffriction": model.tendon_solref_fri[tendon],
            "solimpfriction": model.tendon_solimp_fri[tendon],
        }
        if model.tendon_limited[tendon]:
            values["range"] = model.tendon_range[tendon]
        set_values(node, values)
        for wrap in wraps:
            joint = name_of(model, "joint", model.wrap_objid[wrap])
            ET.SubElement(node, "joint", joint=joint, coef=text_of(model.wrap_prm[wrap]))


def write_equalities(root: ET.Element, model: mujoco.MjModel) -> None:
    """Write all equalities.

    Raises:
        GraspRefineError: An equality is of a type that is not exported.
    """
    equality = ET.SubElement(root, "equality")
    for number in range(model.neq):
        kind, data = mujoco.mjtEq(model.eq_type[number]), model.eq_data[number]
        name = name_of(model, "equality", number)
        one, two = int(model.eq_obj1id[number]), int(model.eq_obj2id[number])
        bodies = model.eq_objtype[number] == mujoco.mjtObj.mjOBJ_BODY
        if kind == mujoco.mjtEq.mjEQ_WELD and bodies:
            node = ET.SubElement(equality, "weld", body1=name_of(model, "body", one), body2=name_of(model, "body", two))
            node.set("anchor", text_of(data[:3]))
            node.set("relpose", text_of(data[3:10]))
            node.set("torquescale", text_of(data[10]))
        elif kind == mujoco.mjtEq.mjEQ_CONNECT and bodies:
            node = ET.SubElement(
                equality, "connect", body1=name_of(model, "body", one), body2=name_of(model, "body", two)
            )
            node.set("anchor", text_of(data[:3]))
        elif kind in (mujoco.mjtEq.mjEQ_JOINT, mujoco.mjtEq.mjEQ_TENDON):
            what = "joint" if kind == mujoco.mjtEq.mjEQ_JOINT else "tendon"
            node = ET.SubElement(equality, what, {f"{what}1": name_of(model, what, one)})
            if two >= 0:
                node.set(f"{what}2", name_of(model, what, two))
            node.set("polycoef", text_of(data[:5]))
        else:
            raise GraspRefineError(f"equality {name}: only weld and connect of bodies, joint and tendon are exported")
        node.set("name", name)
        node.set("active", flag_of(model.eq_active0[number]))
        node.set("solref", text_of(model.eq_solref[number]))
        node.set("solimp", text_of(model.eq_solimp[number]))


def write_actuators(root: ET.Element, model: mujoco.MjModel, force: np.ndarray | None) -> None:
    """Write all actuators and, last, that of the push with this force, if any.

    Raises:
        GraspRefineError: An actuator is of a type that is not exported.
    """
    node = ET.SubElement(root, "actuator")
    transmission = mujoco.mjtTrn
    targets = {
        transmission.mjTRN_JOINT.value: ("joint", "joint"),
        transmission.mjTRN_JOINTINPARENT.value: ("jointinparent", "joint"),
        transmission.mjTRN_TENDON.value: ("tendon", "tendon"),
    }
    for number in range(model.nu):
        name = name_of(model, "actuator", number)
        target = targets.get(int(model.actuator_trntype[number]))
        kinds = (
            (model.actuator_dyntype[number], _DYNAMICS),
            (model.actuator_gaintype[number], _GAINS),
            (model.actuator_biastype[number], _BIASES),
        )
        if target is None or any(kind >= len(known) for kind, known in kinds):
            raise GraspRefineError(
                f"actuator {name}: only those of joints and tendons with fixed or affine gain are exported"
            )
        attribute, what = target
        actuator = ET.SubElement(node, "general", name=name)
        actuator.set(attribute, name_of(model, what, model.actuator_trnid[number, 0]))
        for key, (kind, known) in zip(("dyntype", "gaintype", "biastype"), kinds, strict=True):
            actuator.set(key, known[kind])
        actuator.set("gear", text_of(model.actuator_gear[number]))
        # MuJoCo 3 has as many parameters as 4, of which fixed and affine use the first three.
        for key in ("dynprm", "gainprm", "biasprm"):
            actuator.set(key, text_of(getattr(model, f"actuator_{key}")[number, :3]))
        for key in ("ctrl", "force"):
            limited = getattr(model, f"actuator_{key}limited")[number]
            actuator.set(f"{key}limited", flag_of(limited))
            if limited:
                actuator.set(f"{key}range", text_of(getattr(model, f"actuator_{key}range")[number]))
    if force is not None:
        # At a site with a reference site in the world, a force keeps its direction when the object turns.
        gear = np.concatenate([force, np.zeros(3)])
        push = ET.SubElement(node, "general", name=PUSH, site=PUSH, refsite=f"{PUSH}_frame", gear=text_of(gear))
        push.set("ctrllimited", "true")
        push.set("ctrlrange", "0 1")
