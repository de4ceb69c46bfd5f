"""Creep of contacts in MuJoCo: drift of a held object that nothing pushes.

MuJoCo regularises friction: a contact that should stick slides slowly under the forces of the squeeze alone, the
faster, the softer its friction is (`ContactModel`). A grasp that real friction holds is then lost, at a rate that a
firmer squeeze hardly changes.
"""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import fields, replace

import numpy as np

from grasp_refine.closing.motion import Motion
from grasp_refine.core.array_types import Float
from grasp_refine.core.cores import thread_count
from grasp_refine.core.se3 import distances
from grasp_refine.scene.protocols.contact_model import DEXGRASPBENCH_CONTACT, ContactModel
from grasp_refine.validation.engines.mujoco.stepping import Conditions, Rows
from grasp_refine.validation.engines.mujoco.world import CONES, World
from grasp_refine.validation.simulation import CHUNK_GRASPS, close, simulate
from grasp_refine.validation.trials import Reason, Trials

REST_S = 0.2
"""Time in seconds that an object gets to come to rest after the squeeze, and then over which its drift is measured."""

LOST_SLOWLY = (Reason.MOVED, Reason.ROTATED, Reason.EJECTED_WHILE_CLOSING)
"""Reasons of failures that creep can cause."""


def softer_options(contact: ContactModel) -> dict[str, object]:
    """Return the values of the fields of firm contacts, those of DexGraspBench, that a contact model falls short of."""
    firm = {field.name: getattr(DEXGRASPBENCH_CONTACT, field.name) for field in fields(ContactModel)}
    short = {
        "cone": contact.cone != DEXGRASPBENCH_CONTACT.cone,
        "impratio": contact.impratio < DEXGRASPBENCH_CONTACT.impratio,
        "noslip_iterations": contact.noslip_iterations < DEXGRASPBENCH_CONTACT.noslip_iterations,
    }
    return {name: firm[name] for name, falls_short in short.items() if falls_short}


def creep_of(
    world: World,
    motion: Motion,
    trials: Trials,
    *,
    threads: int | None = None,
    progress: Callable[[float], None] = lambda done: None,
) -> Float[np.ndarray, "N 2"] | None:
    """Return the drift (N, 2) of objects that creep alone loses, over the time of a push, in metres and radians.

    These are the objects that firm contacts hold. For the drift, the hand closes, and nothing pushes the object, whose
    weight is balanced where it has any. NaN in all other rows. None: contacts are as firm as those of DexGraspBench.

    Args:
        world: Hand, object and protocol.
        motion: N grasps.
        trials: Their trials in MuJoCo.
        threads: CPU threads.
        progress: Called with the number of finished grasps, in fractions.
    """
    if not softer_options(world.protocol.contact):
        return None
    found = np.full((len(motion), 2), np.nan)
    lost = np.flatnonzero(np.isin(trials.outcome, LOST_SLOWLY))
    for start in range(0, len(lost), CHUNK_GRASPS):
        rows = lost[start : start + CHUNK_GRASPS]
        held = simulate(_firm(world), motion.select(rows), threads=threads, first_failure=True).success
        rows = rows[held]
        if len(rows):
            found[rows] = _drift(world, motion.select(rows), threads)
        progress(len(motion) * min((start + CHUNK_GRASPS) / len(lost), 1.0))
    return found


def _drift(world: World, motion: Motion, threads: int | None) -> Float[np.ndarray, "N 2"]:
    """Return the drift (N, 2) of objects that nothing pushes over the time of a push, in metres and radians."""
    closed = close(world, motion, Conditions.nominal(world, len(motion)), threads=threads)
    rows = Rows(world, closed.conditions, motion.finite, thread_count(threads))
    rows.resume(closed.state)
    weight = world.mass * world.protocol.acceleration * world.up if world.protocol.tabletop else np.zeros(3)
    rows.push(np.tile(np.append(weight, np.zeros(3)), (len(motion), 1)))
    steps = max(round(REST_S / world.protocol.timestep), 1)
    rows.step(steps)
    rested = rows.object_poses()
    rows.step(steps)
    rate = np.stack(distances(rested, rows.object_poses()), axis=1) / (steps * world.protocol.timestep)
    return rate * world.protocol.seconds


def _firm(world: World) -> World:
    """Return the world with the contacts of DexGraspBench."""
    model, contact = copy.copy(world.model), DEXGRASPBENCH_CONTACT
    model.opt.cone = CONES[contact.cone]
    model.opt.impratio, model.opt.noslip_iterations = contact.impratio, contact.noslip_iterations
    return replace(world, model=model, protocol=replace(world.protocol, contact=contact))
