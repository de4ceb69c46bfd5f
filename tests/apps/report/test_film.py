"""Films: hand, object, contacts and push are seen in them, from a side that shows them."""

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
from PIL import Image

from grasp_refine.scene.protocols.tabletop import TABLETOP
from grasp_refine.scene.task import Task
from grasp_refine.validation.engines.mujoco.world import build_world
from grasp_refine.validation.replay.record import record
from grasp_refine.validation.replay.replay import Replay, Stage
from grasp_refine_apps.report.film import Shapes, film, geom_mesh
from gripper import RADIUS, around, ball, gripper
from recorded_gripper import Recorded, recorded_gripper

SIZE = 240, 200


@pytest.fixture(scope="module")
def recorded() -> Recorded:
    return recorded_gripper()


def picture(model: mujoco.MjModel, replay: Replay, frame: int) -> Image.Image:
    shapes = Shapes(model, replay)
    return shapes.picture(frame, shapes.camera(np.array([frame]), SIZE), SIZE)


def shares(image: Image.Image) -> dict[str, float]:
    """Of the picture: how much is bluish, as the object; grey, as the hand; red, as the arrow; blue, as contacts."""
    red, green, blue = np.moveaxis(np.asarray(image.convert("RGB")).astype(int), 2, 0)
    return {
        "object": ((blue - red > 25) & (blue - red < 90)).mean(),
        "hand": ((abs(red - blue) < 25) & (red < 205) & (red > 60)).mean(),
        "push": ((red - green > 90) & (abs(green - blue) < 45)).mean(),
        "contact": ((blue - red > 110) & (green > red)).mean(),
    }


def test_hand_and_object_are_in_the_picture(recorded: Recorded) -> None:
    image = picture(recorded.model, recorded.replay, 225)
    assert image.size == SIZE and image.mode == "RGB"
    found = shares(image)
    assert found["object"] > 0.02 and found["hand"] > 0.05 and found["push"] > 0.001, found
    assert found["contact"] > 0.00003, found
    before = shares(picture(recorded.model, recorded.replay, 0))
    assert before["push"] == 0 and before["contact"] == 0, before
    assert before["object"] > 0.02, before


def test_a_table_is_seen_from_above() -> None:
    world = build_world(gripper(), ball(), Task(TABLETOP))
    replay = record(world, around(8.0), "lift", name="ball 2", hand="gripper")
    assert replay is None, "the plates reach into the table"
    T = around(8.0).T_world_root.copy()
    T[..., 2, 3] += 0.015
    replay = record(world, replace(around(8.0), T_world_root=T), "lift", name="ball 2", hand="gripper")
    assert replay is not None
    shapes = Shapes(world.model, replay)
    camera = shapes.camera(np.arange(0, len(replay), 40), SIZE)
    assert camera.direction[2] > 0
    _, _, (table,) = shapes.pose(0)
    np.testing.assert_allclose(table.vertices[:, 2].max(), -RADIUS, atol=1e-6)


def test_the_arrow_points_along_the_push(recorded: Recorded) -> None:
    shapes = Shapes(recorded.model, recorded.replay)
    shapes.pose(225)
    (arrow,) = shapes._arrow(225)
    centre = shapes._data.body("object").xipos
    along = (arrow.vertices - centre) @ recorded.replay.force / np.linalg.norm(recorded.replay.force)
    assert along.min() > -1e-6 and along.max() > 0.04
    across = np.linalg.norm(np.cross(arrow.vertices - centre, recorded.replay.force), axis=1)
    assert across.max() < 0.3 * along.max()


def test_shapes_are_where_they_are_simulated() -> None:
    """Each kind of geom, turned and moved, against MuJoCo's own bounding box of it."""
    pose = 'pos="0.1 0.2 0.3" quat="0.5 0.5 0.1 -0.7"'
    kinds = ("sphere", "capsule", "ellipsoid", "cylinder", "box")
    geoms = "".join(f'<geom type="{kind}" size="0.02 0.03 0.05" {pose}/>' for kind in kinds)
    mesh = '<asset><mesh name="m" vertex="0 0 0 0.1 0 0 0 0.2 0 0 0 0.3"/></asset>'
    body = f'<body><freejoint/>{geoms}<geom type="mesh" mesh="m" {pose}/></body>'
    model = mujoco.MjModel.from_xml_string(f"<mujoco>{mesh}<worldbody>{body}</worldbody></mujoco>")
    for geom in range(model.ngeom):
        turn = np.zeros(9)
        mujoco.mju_quat2Mat(turn, model.geom_quat[geom])
        local = (geom_mesh(model, geom).vertices - model.geom_pos[geom]) @ turn.reshape(3, 3)
        centre, half = model.geom_aabb[geom, :3], model.geom_aabb[geom, 3:]
        np.testing.assert_allclose([local.min(0), local.max(0)], [centre - half, centre + half], atol=1e-3)


def frames_of(path: Path) -> list[Image.Image]:
    with Image.open(path) as image:
        assert image.info.get("loop") == 0
        found = []
        for frame in range(image.n_frames):
            image.seek(frame)
            found.append(image.convert("RGB"))
    return found


def test_a_film_has_pictures_that_differ(recorded: Recorded, tmp_path: Path) -> None:
    path = tmp_path / "film.gif"
    count = film(recorded.model, recorded.replay, path, size=(200, 160), rate=5)
    frames = [np.asarray(image).astype(int) for image in frames_of(path)]
    assert len(frames) == count == 6 and frames[0].shape == (160, 200, 3)
    assert all(np.abs(a - b).max() > 20 for a, b in zip(frames, frames[1:], strict=False))
    assert [entry.name for entry in tmp_path.iterdir()] == [path.name]


def test_a_film_ends_where_the_object_is_lost(recorded: Recorded, tmp_path: Path) -> None:
    qpos = recorded.replay.qpos.copy()
    qpos[150:, 1] += np.arange(76)
    lost = replace(recorded.replay, qpos=qpos, reason="moved")
    count = film(recorded.model, lost, tmp_path / "lost.gif", size=(200, 160), rate=10)
    assert count == 7, "0.6 s at 10 pictures a second, both ends counted"
    assert shares(frames_of(tmp_path / "lost.gif")[-1])["object"] > 0.01


def test_an_object_that_is_lifted_high_stays_in_sight(recorded: Recorded, tmp_path: Path) -> None:
    """What is lifted with the hand is not lost, however far from its start."""
    replay = recorded.replay
    lift = np.where(replay.stage == Stage.PUSH, np.linspace(-0.3, 0.4, len(replay)).clip(0), 0.0)
    qpos, mocap_pos = replay.qpos.copy(), replay.mocap_pos.copy()
    root = replay.qpos_names.index("hand z")
    qpos[:, 2], qpos[:, root], mocap_pos[:, 2] = qpos[0, 2] + lift, qpos[:, root] + lift, mocap_pos[:, 2] + lift
    qpos[:, :2], qpos[:, 3:7] = qpos[0, :2], qpos[0, 3:7]
    stage = np.where(replay.stage == Stage.PUSH, Stage.LIFT, replay.stage)
    lifted = replace(replay, qpos=qpos, mocap_pos=mocap_pos, stage=stage, force=np.zeros(3), direction="lift")
    assert film(recorded.model, lifted, tmp_path / "lift.gif", size=(200, 160), rate=5) == 6
    assert shares(frames_of(tmp_path / "lift.gif")[-1])["object"] > 0.002
