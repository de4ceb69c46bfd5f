"""Simulate the grasps of this folder with MuJoCo alone: the hand closes, then the object is pushed, or lifted."""

import sys
from pathlib import Path

import mujoco
import numpy as np

Schedule = dict[str, np.ndarray]
"""Arrays of schedule.npz."""


def main(folder: Path) -> int:
    """Print whether each grasp holds the object; return 0 if all do."""
    model = mujoco.MjModel.from_xml_path(str(folder / "scene.xml"))
    schedule = dict(np.load(folder / "schedule.npz", allow_pickle=False))
    held = [holds(model, schedule, grasp) for grasp in range(len(schedule["close_ctrl"]))]
    for grasp, success in enumerate(held):
        print(f"grasp {grasp}: {'held' if success else 'lost'}")
    print(f"{sum(held)} of {len(held)} held")
    return 0 if all(held) else 1


def holds(model: mujoco.MjModel, schedule: Schedule, grasp: int) -> bool:
    """Return whether a grasp holds the object in as many pushes as it must, or while it is lifted."""
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key(f"pregrasp_{grasp}").id)
    data.time = 0.0
    mujoco.mj_forward(model, data)
    start = data.joint("object").qpos.copy()
    if depth(model, data) > schedule["deepest"]:
        return False
    follow(model, data, schedule, "close", grasp, int(schedule["steps"]))
    if is_lost(data, start, schedule):
        return False
    size = mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_INTEGRATION)
    closed = np.empty(size)
    mujoco.mj_getState(model, data, closed, mujoco.mjtState.mjSTATE_INTEGRATION)
    if not len(schedule["push"]):
        return lifts(model, data, schedule, grasp, start)
    body, held = model.body("object").id, 0
    for force in schedule["push"]:
        mujoco.mj_setState(model, data, closed, mujoco.mjtState.mjSTATE_INTEGRATION)
        data.xfrc_applied[body, :3] = force
        for _ in range(int(schedule["checks"])):
            mujoco.mj_step(model, data, nstep=int(schedule["push_steps"]))
            if is_lost(data, start, schedule):
                break
        else:
            held += 1
    return held >= int(schedule["required"])


def lifts(model: mujoco.MjModel, data: mujoco.MjData, schedule: Schedule, grasp: int, start: np.ndarray) -> bool:
    """Return whether the object follows the hand upwards."""
    rows = schedule["lift_ctrl"].shape[1]
    parts = rows // int(schedule["checks"])
    for row in range(rows):
        follow(model, data, schedule, "lift", grasp, int(schedule["push_steps"]) // parts, slice(row, row + 1))
        wanted = start.copy()
        wanted[:3] += float(schedule["lift_height"]) * (row + 1) / rows * schedule["up"]
        if (row + 1) % parts == 0 and is_lost(data, wanted, schedule):
            return False
    return True


def follow(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    schedule: Schedule,
    part: str,
    grasp: int,
    steps: int,
    rows: slice = slice(None),
) -> None:
    """Send the hand through set points, with some steps after each."""
    series = (schedule[f"{part}_{key}"][grasp, rows] for key in ("ctrl", "pos", "quat"))
    for ctrl, pos, quat in zip(*series, strict=True):
        data.ctrl[:], data.mocap_pos[0], data.mocap_quat[0] = ctrl, pos, quat
        mujoco.mj_step(model, data, nstep=steps)


def is_lost(data: mujoco.MjData, wanted: np.ndarray, schedule: Schedule) -> bool:
    """Return whether the object is too far from a pose (x y z, quaternion), or turned too far."""
    pose = data.joint("object").qpos
    moved = np.linalg.norm(pose[:3] - wanted[:3])
    turned = 2.0 * np.arccos(min(abs(pose[3:] @ wanted[3:]) / np.linalg.norm(pose[3:]), 1.0))
    return not (moved < schedule["farthest"] and turned < schedule["steepest"])


def depth(model: mujoco.MjModel, data: mujoco.MjData) -> float:
    """Return the largest penetration of hand and object, metres."""
    hand = np.array([model.body(body).name.startswith("hand/") for body in model.geom_bodyid])
    thing = model.geom_bodyid == model.body("object").id
    first, second = data.contact.geom.T
    between = (hand[first] & thing[second]) | (thing[first] & hand[second])
    return float(np.max(-data.contact.dist[between], initial=0.0))


if __name__ == "__main__":
    sys.exit(main(Path(__file__).resolve().parent))
