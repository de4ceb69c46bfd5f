"""Cost of validating a grasp, in CPU seconds: ours against a plain loop of the protocol, on the same grasps.

Run `python -m grasp_refine_apps.bench.simulation GRASPS --hand HAND --objects DIR`. The peer is a plain loop over
MuJoCo's own functions, as a user would write it: each grasp compiles its scene, and for each direction the hand
starts at the pregrasp, closes and the object is pushed; the first direction that fails ends the grasp. The physics
are the same: verdicts are compared, and must agree. The peer runs our model, with one contact per pair of pieces; with
MuJoCo 4's own default, up to four, it takes about twice as long.
"""

import argparse
import time
from pathlib import Path

import mujoco
import numpy as np
import torch
from rich.console import Console

from grasp_refine.closing.motion import Motion
from grasp_refine.core.json_files import save_json
from grasp_refine.core.se3 import distances, exp_so3, log_so3, pose_from_transform, transform_from_pose
from grasp_refine.hands.files.mujoco_messages import unlogged
from grasp_refine.hands.hand import Hand
from grasp_refine.problem.load import load_problem
from grasp_refine.problem.spec import ProblemSpec
from grasp_refine.scene.protocols.dexgraspbench import DEXGRASPBENCH
from grasp_refine.scene.protocols.protocol import AXES
from grasp_refine.scene.scene import Scene
from grasp_refine.scene.task import Task
from grasp_refine.validation.engines.mujoco.world import World, build_world
from grasp_refine.validation.simulation import simulate
from grasp_refine.validation.validate import model_of
from grasp_refine_apps.bench.chart import Row
from grasp_refine_apps.bench.report import Column, Table


def plain(world: World, motion: Motion) -> bool:
    """Return True where one grasp holds, by a plain loop over directions and steps."""
    protocol = world.protocol
    model = world.spec.compile()
    data = mujoco.MjData(model)
    T = motion.T_world_root[0] @ world.hand.T_base_root
    joints = motion.q[0] @ world.hand.matrix.T + world.hand.offset
    for axis in AXES.values():
        mujoco.mj_resetData(model, data)
        assert world.root_at is not None  # a hand without an arm
        data.qpos[world.root_at : world.root_at + 7] = pose_from_transform(T[0])
        data.qpos[world.joints_at] = joints[0]
        data.qpos[world.object_at : world.object_at + 7] = [0, 0, 0, 1, 0, 0, 0]
        for stage in (0, 1):
            turn = log_so3(T[stage, :3, :3].T @ T[stage + 1, :3, :3])
            for share in np.arange(1, protocol.moves + 1) / protocol.moves:
                data.mocap_pos[0] = T[stage, :3, 3] + share * (T[stage + 1, :3, 3] - T[stage, :3, 3])
                pose = np.eye(4)
                pose[:3, :3] = T[stage, :3, :3] @ exp_so3(share * turn)
                data.mocap_quat[0] = pose_from_transform(pose)[3:]
                data.ctrl[:] = world.control @ (joints[stage] + share * (joints[stage + 1] - joints[stage]))
                mujoco.mj_step(model, data, protocol.steps_per_move)
        data.xfrc_applied[world.object_body, :3] = protocol.mass * protocol.acceleration * np.array(axis)
        for _ in range(protocol.checks):
            mujoco.mj_step(model, data, protocol.steps_per_check)
            now = transform_from_pose(data.qpos[world.object_at : world.object_at + 7])
            moved, turned = distances(np.eye(4)[None], now[None])
            if not (moved[0] < protocol.farthest and turned[0] < protocol.steepest):
                return False
    return True


def measure(hand: Hand, scene: Scene, motion: Motion) -> dict[str, float]:
    """Measure CPU seconds per grasp of ours and of the peer, and the number of equal verdicts."""
    start = time.process_time()
    world = build_world(model_of(hand), scene.object, Task(DEXGRASPBENCH))
    built = time.process_time()
    ours = simulate(world, motion, threads=1)
    done = time.process_time()
    with unlogged():
        peer = [plain(world, motion.select(np.array([i]))) for i in range(len(motion))]
    end = time.process_time()
    # A grasp that fails before the push has no verdict of the peer.
    tried = np.isfinite(ours.displacement_m).all(axis=1)
    count = len(motion)
    return {
        "grasps": count,
        "held": int(ours.success.sum()),
        "compile_s": built - start,
        "ours_s": (done - built) / count,
        "peer_s": (end - done) / count,
        "agree": int((ours.success == np.array(peer))[tried].sum()) + int((~tried).sum()),
    }


def main() -> None:
    """Measure the grasps of a file and print their costs."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("grasps", type=Path, help="grasp file (.npz)")
    parser.add_argument("--hand", default="allegro")
    parser.add_argument("--urdf", type=Path)
    parser.add_argument("--mjcf", type=Path)
    parser.add_argument("--objects", type=Path, help="folder of meshes or of folders of convex pieces; else embedded")
    parser.add_argument("--count", type=int, default=5, help="largest number of grasps of each object and scale")
    parser.add_argument("--json", type=Path)
    options = vars(parser.parse_args())
    count, json = options.pop("count"), options.pop("json")
    torch.set_num_threads(1)
    problem = load_problem(ProblemSpec(**options))
    rows: list[Row] = []
    for group in problem.groups:
        motion = group.motion().select(np.arange(len(group.rows))[:count])
        found = measure(problem.hand, group.scene, motion)
        rows.append({"object": group.object, "scale": group.scale, **found, "ratio": found["peer_s"] / found["ours_s"]})
    console = Console()
    console.print(Table("Validation of grasps", COLUMNS, rows).printed())
    total = sum(row["grasps"] for row in rows)
    ours, peer = (sum(row[key] * row["grasps"] for row in rows) / total for key in ("ours_s", "peer_s"))
    console.print(f"CPU per grasp: {ours:.3f} s, peer {peer:.3f} s, ratio {peer / ours:.2f}; {total} grasps")
    if json is not None:
        save_json(json, rows)


COLUMNS = (
    Column("object", "object"),
    Column("scale", "scale", form="g"),
    Column("grasps", "grasps", form="d"),
    Column("held", "held", form="d"),
    Column("compile_s", "compile", "s", ".3f"),
    Column("ours_s", "ours", "s", ".3f"),
    Column("peer_s", "peer", "s", ".3f"),
    Column("ratio", "ratio", form=".1f"),
    Column("agree", "agree", form="d"),
)


if __name__ == "__main__":
    main()
