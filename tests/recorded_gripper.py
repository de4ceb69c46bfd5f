"""A gripper of two sliding jaws that closes on a ball of mesh and box, recorded without the rest of the package."""

from dataclasses import dataclass

import mujoco
import numpy as np

from grasp_refine.validation.replay.replay import Replay, Stage, qpos_names

FORCE = np.array([0.0, 0.7, 0.7])


@dataclass(frozen=True, eq=False)
class Recorded:
    """What was simulated, and what came of it; a frame of the start, and one for each simulation step."""

    spec: mujoco.MjSpec
    model: mujoco.MjModel
    replay: Replay


def gripper_spec() -> mujoco.MjSpec:
    """The gripper, hung from a mocap body; with something of everything that hands have."""
    spec = mujoco.MjSpec()
    option, disable = spec.option, mujoco.mjtDisableBit
    option.timestep, option.impratio, option.noslip_iterations = 0.004, 10.0, 2
    option.integrator, option.cone = mujoco.mjtIntegrator.mjINT_IMPLICITFAST, mujoco.mjtCone.mjCONE_ELLIPTIC
    option.gravity = [0.0, 0.0, 0.0]
    option.disableflags |= disable.mjDSBL_AUTORESET | disable.mjDSBL_MULTICCD
    box, capsule, mesh = (getattr(mujoco.mjtGeom, f"mjGEOM_{kind}") for kind in ("BOX", "CAPSULE", "MESH"))

    obj = spec.worldbody.add_body(name="object", pos=[0.0, 0.0, 0.1])
    obj.add_freejoint(name="object")
    points = np.random.default_rng(0).normal(size=(40, 3))
    spec.add_mesh(name="pebble", uservert=(0.03 * points / np.linalg.norm(points, axis=1, keepdims=True)).ravel())
    obj.add_geom(name="object_0", type=mesh, meshname="pebble", mass=0.06, pos=[0.001, 0.0, 0.002])
    obj.add_geom(name="object_1", type=box, size=[0.01, 0.01, 0.02], mass=0.04, pos=[0.0, 0.02, 0.0])

    palm = spec.worldbody.add_body(name="hand/palm", gravcomp=1.0)
    palm.add_freejoint(name="hand")
    palm.add_geom(type=box, size=[0.07, 0.03, 0.02], mass=0.4)
    palm.add_geom(type=box, size=[0.5, 0.5, 0.5], contype=0, conaffinity=0, mass=0.0)
    for side, name in ((-1, "left"), (1, "right")):
        jaw = palm.add_body(name=f"hand/{name}", pos=[0.06 * side, 0.0, 0.09], quat=[0.8, 0.0, 0.0, 0.6])
        joint = jaw.add_joint(name=f"hand/{name}", type=mujoco.mjtJoint.mjJNT_SLIDE)
        joint.axis = np.array([-0.28, -0.96, 0.0]) * -side if side < 0 else np.array([-0.28, 0.96, 0.0])
        joint.armature, joint.damping[0], joint.frictionloss = 0.001, 0.5, 0.01
        joint.limited, joint.range = mujoco.mjtLimited.mjLIMITED_TRUE, [-0.01, 0.05]
        jaw.add_geom(type=box, size=[0.015, 0.005, 0.04], mass=0.05)
        tip = jaw.add_body(name=f"hand/{name}_tip", pos=[0.0, 0.0, 0.04])
        tip.add_joint(
            name=f"hand/{name}_tip", axis=[1, 0, 0], stiffness=[0.5, 0, 0], damping=[0.01, 0, 0], springref=0.05
        )
        tip.add_geom(type=capsule, size=[0.006, 0.01, 0.0], mass=0.01, fromto=[-0.01, 0, 0.01, 0.01, 0, 0.01])
    spec.add_exclude(bodyname1="hand/palm", bodyname2="hand/left_tip")

    pair = spec.add_tendon(name="hand/jaws")
    pair.wrap_joint("hand/left", 1.0)
    pair.wrap_joint("hand/right", 1.0)
    servo = spec.add_actuator(name="hand/jaws", target="hand/jaws", trntype=mujoco.mjtTrn.mjTRN_TENDON)
    servo.set_to_position(kp=200.0, kv=1.0)
    servo.forcelimited, servo.forcerange = mujoco.mjtLimited.mjLIMITED_TRUE, [-10.0, 10.0]
    follow = spec.add_equality(name="hand/follow", type=mujoco.mjtEq.mjEQ_JOINT, objtype=mujoco.mjtObj.mjOBJ_JOINT)
    follow.name1, follow.name2 = "hand/right", "hand/left"
    follow.data[:5] = [0.0, 1.0, 0.0, 0.0, 0.0]

    for geom in spec.geoms:
        geom.condim, geom.friction = 4, [0.6, 0.02, 1e-4]
    spec.worldbody.add_body(name="holder", mocap=True)
    weld = spec.add_equality(name="holder", type=mujoco.mjtEq.mjEQ_WELD, objtype=mujoco.mjtObj.mjOBJ_BODY)
    weld.name1, weld.name2 = "holder", "hand/palm"
    weld.data[:11] = [0, 0, 0, 0, 0, 0, 1, 0, 0, 0, 1]
    return spec


def recorded_gripper(force: np.ndarray = FORCE) -> Recorded:
    """The gripper closes, squeezes, and holds the object against a push of half a second."""
    spec = gripper_spec()
    model = spec.compile()
    data = mujoco.MjData(model)
    stages = [Stage.CLOSE] * 51 + [Stage.SQUEEZE] * 50 + [Stage.PUSH] * 125
    columns: dict[str, list[np.ndarray]] = {
        key: [] for key in ("time", "qpos", "qvel", "ctrl", "mocap_pos", "mocap_quat")
    }
    for step, stage in enumerate(stages):
        if step:
            data.ctrl[0] = 0.06 * min(step / 50, 1.0) + 0.04 * np.clip((step - 50) / 50, 0.0, 1.0)
            if stage == Stage.PUSH:
                data.xfrc_applied[model.body("object").id, :3] = force
            mujoco.mj_step(model, data)
        for key, column in columns.items():
            column.append(np.array(getattr(data, key)[0] if key.startswith("mocap") else getattr(data, key)))
    replay = Replay(
        name="pebble 7",
        hand="gripper",
        object="pebble",
        direction="+y",
        protocol="dexgraspbench",
        reason="held",
        force=force,
        qpos_names=qpos_names(model),
        stage=np.array(stages, dtype=int),
        **{key: np.array(column, dtype=float) for key, column in columns.items()},
    )
    return Recorded(spec, model, replay)
