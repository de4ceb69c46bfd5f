"""Exported models move as those that they were exported from."""

import re
import xml.etree.ElementTree as ET
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from grasp_refine.core.errors import GraspRefineError
from grasp_refine.validation.replay import export
from grasp_refine.validation.replay.export import PUSH, export_xml
from grasp_refine.validation.replay.replay import qpos_names
from recorded_gripper import Recorded, gripper_spec, recorded_gripper
from refusals import refused


@pytest.fixture(scope="module")
def recorded() -> Recorded:
    return recorded_gripper()


@pytest.fixture(scope="module")
def exported(recorded: Recorded, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("export")
    export_xml(recorded.spec, recorded.model, recorded.replay, folder / "new" / "replay.xml")
    assert [path.name for path in (folder / "new").iterdir()] == ["replay.xml"], "one file, nothing beside it"
    # Wherever it is taken.
    return (folder / "new" / "replay.xml").rename(folder / "moved.xml")


def steps(model: mujoco.MjModel, source: mujoco.MjModel, key: str, count: int, force: np.ndarray) -> np.ndarray:
    """Values of qpos after steps of `model` from a key frame of `source`."""
    data = mujoco.MjData(model)
    frame = source.key(key).id
    data.qpos[:], data.qvel[:] = source.key_qpos[frame], source.key_qvel[frame]
    data.ctrl[:] = source.key_ctrl[frame][: model.nu]
    data.mocap_pos[:], data.mocap_quat[:] = (
        source.key_mpos[frame].reshape(-1, 3),
        source.key_mquat[frame].reshape(-1, 4),
    )
    data.xfrc_applied[model.body("object").id, :3] = force
    for _ in range(count):
        mujoco.mj_step(model, data)
    return data.qpos.copy()


def test_the_physics_is_read_back_exactly(recorded: Recorded, exported: Path) -> None:
    ours, theirs = recorded.model, mujoco.MjModel.from_xml_path(str(exported))
    for name in ("body_mass", "body_inertia", "body_ipos", "body_iquat", "geom_friction", "mesh_vert", "mesh_graph"):
        np.testing.assert_array_equal(getattr(theirs, name), getattr(ours, name), err_msg=name)
    np.testing.assert_allclose(theirs.geom_pos, ours.geom_pos, atol=1e-15)
    for name in ("timestep", "cone", "impratio", "integrator", "noslip_iterations", "gravity", "solver", "tolerance"):
        np.testing.assert_array_equal(getattr(theirs.opt, name), getattr(ours.opt, name), err_msg=name)
    assert theirs.opt.disableflags == ours.opt.disableflags & ~int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
    assert theirs.nu == ours.nu + 1 and theirs.actuator(ours.nu).name == PUSH


def test_the_push_goes_on_as_it_was_recorded(recorded: Recorded, exported: Path) -> None:
    model, replay = mujoco.MjModel.from_xml_path(str(exported)), recorded.replay
    count = 125
    expected = steps(recorded.model, model, "squeeze", count, replay.force)
    found = steps(model, model, "squeeze", count, np.zeros(3))
    np.testing.assert_allclose(found, expected, atol=1e-9, rtol=0)
    assert np.abs(steps(model, model, "grasp", count, np.zeros(3)) - expected).max() > 1e-4, "a push does something"
    # The solver of the recorded simulation started from its own last solution, which key frames do not have.
    np.testing.assert_allclose(found, replay.qpos[-1], atol=1e-5, rtol=0)


def test_the_push_keeps_its_direction_when_the_object_turns(recorded: Recorded, exported: Path) -> None:
    model = mujoco.MjModel.from_xml_path(str(exported))
    data = mujoco.MjData(model)
    data.joint("object").qpos[3:] = [0.6, 0.0, 0.8, 0.0]
    data.ctrl[-1] = 1.0
    mujoco.mj_forward(model, data)
    np.testing.assert_allclose(data.joint("object").qfrc_actuator[:3], recorded.replay.force, atol=1e-12)
    arm = data.body("object").xipos - data.joint("object").qpos[:3]
    torque = data.body("object").xmat.reshape(3, 3).T @ np.cross(arm, recorded.replay.force)
    np.testing.assert_allclose(data.joint("object").qfrc_actuator[3:], torque, atol=1e-12)


def test_key_frames_are_frames_of_the_replay(recorded: Recorded, exported: Path) -> None:
    model, replay = mujoco.MjModel.from_xml_path(str(exported)), recorded.replay
    names = [model.key(i).name for i in range(model.nkey)]
    assert len(names) == len(set(names)) == 60
    assert names[0] == "pregrasp" and names[-1] == "push 0.500 s"
    assert model.key("pregrasp").time == 0, "the state before the first step"
    assert names.index("pregrasp") < names.index("grasp") < names.index("squeeze")
    for name, frame, pushing in (("pregrasp", 0, 0), ("grasp", 50, 0), ("squeeze", 100, 1), ("push 0.500 s", 225, 1)):
        key = model.key(name)
        np.testing.assert_allclose(key.qpos, replay.qpos[frame], atol=1e-15)
        np.testing.assert_array_equal(key.qvel, replay.qvel[frame])
        np.testing.assert_array_equal(key.ctrl, [*replay.ctrl[frame], pushing])
        np.testing.assert_array_equal(key.mpos.ravel(), replay.mocap_pos[frame])
        assert key.time == replay.time[frame]


def test_words_that_mujoco_3_refuses_are_not_used(exported: Path) -> None:
    text = exported.read_text()
    assert 'multiccd="disable"' in text
    for word in ("autoreset", "input=", "file="):
        assert not re.search(rf"\b{word}", text), word
    # MuJoCo 3.3.0 to 3.3.2 know lights by this word alone.
    lights = ET.fromstring(text).findall(".//light")
    assert [(light.get("directional"), light.get("type")) for light in lights] == [("true", None)]
    assert (mujoco.MjModel.from_xml_string(text).light_type == mujoco.mjtLightType.mjLIGHT_DIRECTIONAL).all()


def test_what_is_not_written_exactly_is_named(
    recorded: Recorded, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "none.xml"
    with monkeypatch.context() as patch:
        # MuJoCo's own six digits.
        patch.setattr(export, "_all_digits", nullcontext)
        with refused(GraspRefineError, "body_iquat"):
            export_xml(recorded.spec, recorded.model, recorded.replay, path)
    spec = gripper_spec()
    spec.joint("hand/left").name = "hand/other"
    for thing in (*spec.tendons, *spec.actuators, *spec.equalities):
        if thing.name != "holder":
            spec.delete(thing)
    with refused(GraspRefineError, "hand/left, hand/other"):
        export_xml(spec, spec.compile(), recorded.replay, path)
    assert not path.exists()


def test_a_hand_with_meshes_from_files_is_exported(recorded: Recorded, shared_assets: Path, tmp_path: Path) -> None:
    """The Shadow hand: default classes, meshes from scaled OBJ files, fixed tendons, excludes."""
    hand = mujoco.MjSpec.from_file(str(shared_assets / "hands/shadow_mjcf/right_hand_22dof_dgb.xml"))
    spec = mujoco.MjSpec()
    spec.option.impratio, spec.option.cone = hand.option.impratio, hand.option.cone
    spec.worldbody.add_body(name="object", pos=[0.0, -0.08, 0.1]).add_freejoint(name="object")
    spec.body("object").add_geom(name="object", size=[0.03, 0, 0], mass=0.1)
    spec.attach(hand, prefix="hand/", frame=spec.worldbody.add_frame())
    root = next(body for body in spec.bodies if body.name.startswith("hand/"))
    root.add_freejoint(name="hand")
    spec.worldbody.add_body(name="holder", mocap=True, pos=root.pos)
    weld = spec.add_equality(name="holder", type=mujoco.mjtEq.mjEQ_WELD, objtype=mujoco.mjtObj.mjOBJ_BODY)
    weld.name1, weld.name2 = "holder", root.name
    weld.data[:11] = [0, 0, 0, 0, 0, 0, 1, 0, 0, 0, 1]
    model = spec.compile()
    data, qpos = mujoco.MjData(model), []
    for step in range(100):
        data.ctrl[:] = 0.012 * step
        mujoco.mj_step(model, data)
        qpos.append(data.qpos.copy())
    replay = replace(
        recorded.replay,
        qpos_names=tuple(f"object {axis}" for axis in ("x", "y", "z", "qw", "qx", "qy", "qz")),
        **{key: getattr(recorded.replay, key)[:100] for key in ("time", "stage", "mocap_pos", "mocap_quat")},
        qpos=np.array(qpos),
        qvel=np.zeros((100, model.nv)),
        ctrl=np.full((100, model.nu), 1.2),
    )
    with refused(GraspRefineError, replay.name):
        export_xml(spec, model, replay, tmp_path / "shadow.xml")
    replay = replace(replay, qpos_names=qpos_names(model), mocap_pos=np.tile(root.pos, (100, 1)))
    export_xml(spec, model, replay, tmp_path / "shadow.xml")
    exported = mujoco.MjModel.from_xml_path(str(tmp_path / "shadow.xml"))
    zero = np.zeros(3)
    expected = steps(model, exported, "squeeze", 20, zero)
    np.testing.assert_allclose(steps(exported, exported, "squeeze", 20, zero), expected, atol=1e-4)
    assert np.abs(expected - replay.qpos[-1]).max() > 1e-3, "it moves"
