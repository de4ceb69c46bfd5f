"""Result files: refined grasps in the format of grasp files, with their contacts, measures and provenance."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from grasp_refine.closing.motion import STAGES
from grasp_refine.core.errors import GraspFileError
from grasp_refine.core.json_files import dumps
from grasp_refine.core.short_repr import labels
from grasp_refine.grasps.formats.folders import UNUSUAL
from grasp_refine.grasps.grasp_set import OTHER_STAGES, ContactLinks, GraspSet, Stage, Targets, save_npz
from grasp_refine.grasps.provenance import read_provenance
from grasp_refine.hands.hand import Hand
from grasp_refine.results.certificate import certificate_entries, conditions_of
from grasp_refine.results.outcome import Outcome
from grasp_refine.results.simulated import SimulatedGrasps
from grasp_refine.scene.task import Task
from grasp_refine.validation.trials import Reason, Trials


def result_paths(folder: Path, hand: str, objects: tuple[str, ...]) -> dict[str, Path]:
    """Return object name -> path of its result file, <hand>_<object>.npz with unusual characters replaced."""
    paths: dict[str, Path] = {}
    for name in objects:
        stem = UNUSUAL.sub("_", f"{hand}_{name}")
        while folder / f"{stem}.npz" in paths.values():
            stem += "_"
        paths[name] = folder / f"{stem}.npz"
    return paths


def refined_set(hand: Hand, links: tuple[str, ...], outcome: Outcome) -> GraspSet:
    """Return the refined grasps of an outcome, with targets, pregrasps and squeezes.

    Args:
        hand: The hand.
        links: Its links with collision geometry, as in `Scene.links`.
        outcome: The grasps.
    """
    aimed = np.flatnonzero(~np.isnan(outcome.target_point_link[..., 0]).all(axis=0))
    names = tuple(links[k] for k in aimed)
    targets = (
        Targets(names, outcome.target_point_link[:, aimed], outcome.target_point_object[:, aimed]) if names else None
    )
    return GraspSet(
        hand=hand.name,
        base_link=hand.base_link,
        joint_names=hand.joint_names,
        object=outcome.object,
        scale=outcome.scale,
        hand_pose=outcome.hand_pose,
        q=outcome.q,
        targets=targets,
        labels=outcome.labels,
        contact_links=ContactLinks.of(links, outcome.contact_gap),
        **{
            name: Stage(outcome.stage_pose[:, at], outcome.stage_q[:, at])
            for at, name in enumerate(STAGES)
            if name in OTHER_STAGES
        },
    )


def save_results(
    path: Path,
    hand: Hand,
    links: tuple[str, ...],
    outcome: Outcome,
    provenance: Mapping[str, Any],
    simulated: SimulatedGrasps | None = None,
    task: Task | None = None,
) -> None:
    """Write the grasps of one object as a grasp file with further entries; the file appears whole or not at all.

        contact_links, contact_gaps         (N, M)     the contact links of the refined grasps, and the gaps they keep
        hand_pose_before, q_before             (N, 7), (N, n)  the grasps before refinement, as hand_pose and q
        contact_link                        (K,)       links that should touch in any of the grasps
        contact_point_link                  (N, K, 3)  witness point on the link, link frame, metres
        contact_point_object                (N, K, 3)  witness point on the object, object frame
        contact_normal                      (N, K, 3)  unit normal from link to object, object frame
        contact_distance                    (N, K)     signed distance, metres
        contact_probability                 (N, K)     probability that the link touches; of scanned objects alone
        forces_grasp                        (C,)       row of the grasp of each force of the squeezes
        forces_link                         (C,)       link that presses
        forces_point                        (C, 3)     contact point on the object, object frame, metres
        forces_normal                       (C, 3)     unit normal into the object, object frame
        forces_vector                       (C, 3)     planned force of the link on the object, object frame, newtons
        status, change                      (N,)       status of the refinement, and what it changed
        quality_before, quality_after, ...  (N,)       `Measure.entries` of each of `RECORDED`, SI units
        provenance                          ()         JSON: versions, seed, config, source, hand, objects, index, row

    and where grasps were simulated, of the direction that was worst for each, before and after

        simulation_before, _after                (N,)  whether the grasp held, in all directions
        simulation_reason_before, _after         (N,)  reason of the failure
        simulation_direction_before, _after      (N,)  the direction
        simulation_displacement_m_before, _after (N,)  displacement of the object at the end, metres
        simulation_angle_rad_before, _after      (N,)  rotation of the object, radians
        held_ENGINE_before, _after               (N,)  whether it held in each engine: 1, 0; NaN: not simulated
        reason_ENGINE_before, _after             (N,)  reason of the failure in it
        certificate                              ()    JSON: protocol, task, version and seed of each engine

    Entries are NaN where a grasp has no such contact or target, and for the stages of one that could not be refined.

    Args:
        path: The file.
        hand: The hand.
        links: Its links with collision geometry, as in `Scene.links`.
        outcome: The grasps.
        provenance: Provenance of the grasps.
        simulated: The grasps in simulation; None: not simulated.
        task: Task of the grasps, for the certificate of a simulation.

    Raises:
        GraspFileError: the file cannot be written.
    """
    grasps = refined_set(hand, links, outcome)
    save_npz(
        path,
        {
            **grasps.arrays(),
            **result_entries(links, outcome),
            **({} if simulated is None else _verdicts(simulated, task or Task(), grasps)),
            "provenance": np.array(dumps({**provenance, "index": outcome.index, "row": outcome.row})),
        },
    )


def result_entries(links: tuple[str, ...], outcome: Outcome) -> dict[str, np.ndarray]:
    """Return the entries of a result file beside the grasps: poses before, contacts, forces, texts and measures.

    Args:
        links: Links of the hand with collision geometry, as in `Scene.links`.
        outcome: The grasps.
    """
    touching = np.flatnonzero(outcome.touching.any(axis=0))
    likely = outcome.contact_probability[:, touching]
    return {
        "hand_pose_before": outcome.hand_pose_before,
        "q_before": outcome.q_before,
        "contact_link": np.array([links[k] for k in touching], dtype=str),
        "contact_point_link": outcome.contact_point_link[:, touching],
        "contact_point_object": outcome.contact_point_object[:, touching],
        "contact_normal": outcome.contact_normal[:, touching],
        "contact_distance": outcome.contact_distance[:, touching],
        **({} if np.isnan(likely).all() else {"contact_probability": likely}),
        **({} if outcome.forces is None else outcome.forces.flat().entries()),
        **outcome.texts(),
        **outcome.entries(),
    }


def _verdicts(simulated: SimulatedGrasps, task: Task, grasps: GraspSet) -> dict[str, np.ndarray]:
    """Return the entries of the trials that decide, and the certificate of all engines."""
    # Refined grasps are simulated with the pregrasps and squeezes that the file has.
    conditions = conditions_of(simulated.protocol, task, dict.fromkeys(OTHER_STAGES, "file"), grasps.arrays())
    sides = {"before": simulated.in_before, "after": simulated.in_after}
    of_first = _simulated("before", simulated.before) | _simulated("after", simulated.after)
    return of_first | certificate_entries(conditions, sides)


def _simulated(when: str, trials: Trials) -> dict[str, np.ndarray]:
    """Return the entries of the trials of N grasps, each with its worst direction."""
    rows, worst = np.arange(len(trials)), trials.worst
    return {
        f"simulation_{when}": trials.success,
        **({} if trials.label is None else {f"simulation_label_{when}": trials.label}),
        f"simulation_reason_{when}": labels(Reason, trials.outcome),
        f"simulation_direction_{when}": np.array(trials.directions)[worst],
        f"simulation_displacement_m_{when}": trials.displacement_m[rows, worst],
        f"simulation_angle_rad_{when}": trials.angle_rad[rows, worst],
    }


def fingerprint(path: Path) -> dict[str, str]:
    """Return path and sha256 of a file, for provenance; of a folder, the hash of names and hashes of all its files."""
    if path.is_dir():
        files = sorted(file for file in path.rglob("*") if file.is_file())
        listing = [f"{file.relative_to(path).as_posix()} {_sha256(file.read_bytes())}\n" for file in files]
        return {"path": str(path), "sha256": _sha256("".join(listing).encode())}
    return {"path": str(path), "sha256": _sha256(path.read_bytes())}


def is_same_refinement(path: Path, stamp: str, protocol: Any) -> bool:
    """Return True if a file holds what will be written: the same grasps, refined in the same way.

    Only results of a simulation may be added; they differ where the protocol does.

    Args:
        path: The file.
        stamp: Hash of all that the refined grasps depend on.
        protocol: Settings of the simulation; None: no simulation.
    """
    try:
        found = read_provenance(path) if path.is_file() else {}
        return found.get("stamp") == stamp and found["config"]["protocol"] in (None, json.loads(dumps(protocol)))
    except (GraspFileError, LookupError, TypeError):
        return False


def _sha256(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()
