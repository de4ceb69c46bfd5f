"""Worlds in Drake against the same worlds in MuJoCo: poses, inertias, depths, dry friction and pairs that touch."""

import mujoco
import numpy as np
import pytest

from engine_rows import both, driven
from grasp_refine.core.se3 import transform, transform_from_pose
from grasp_refine.scene.plane import Plane
from grasp_refine.scene.protocols.dexgraspbench import DEXGRASPBENCH
from grasp_refine.scene.protocols.tabletop import TABLETOP
from grasp_refine.scene.task import Task
from grasp_refine.validation.engines.drake.plant import rigid
from grasp_refine.validation.engines.geom_pairs import touching_pairs
from grasp_refine.validation.engines.mujoco.stepping import Conditions
from grasp_refine.validation.engines.mujoco.world import build_world
from grasp_refine.validation.engines.simulations import OBJECT_GEOM
from gripper import ball
from rich_hands import JOINTS, LEFT, NAMES, TIED, model, random_poses, rich

EXACT = [int(getattr(mujoco.mjtGeom, f"mjGEOM_{kind}")) for kind in ("BOX", "CAPSULE", "SPHERE")]
"""Kinds of geoms of whose depths Drake makes no error."""


def test_bodies_are_where_mujoco_has_them_and_overlap_as_deeply() -> None:
    """An object at each geom in turn, at random joint values and poses of the root."""
    world = build_world(rich(), ball(), Task(TABLETOP, table=Plane((0.6, 0.0, 0.8), offset=-0.05)))
    model = world.model
    geoms = np.flatnonzero(np.array(world.link_of_geom) >= 0)
    count, rng = 4 * len(geoms), np.random.default_rng(0)
    drake, other = both("drake", world, Conditions.nominal(world, count))
    root, values = random_poses(count, 1), rng.uniform([-1, -1, -1, -0.01], [1, 1, 1, 0.01], (count, 4))
    place, data = np.tile([0.0, 0, 0, 1, 0, 0, 0], (count, 1)), mujoco.MjData(model)
    (of_object,), ends, poses = np.flatnonzero(world.link_of_geom == OBJECT_GEOM), np.zeros(6), []
    dofs = [model.joint(f"hand/{name}").dofadr[0] for name in JOINTS]
    inertia = np.zeros((count, len(JOINTS), model.nv))
    for row in range(count):
        data.qpos[world.root_at : world.root_at + 7], data.qpos[world.joints_at] = root[row], values[row]
        mujoco.mj_kinematics(model, data)
        geom = int(geoms[row % len(geoms)])
        data.qpos[world.object_at :][:3] = data.geom_xpos[geom] + rng.normal(size=3) * 0.1
        mujoco.mj_kinematics(model, data)
        apart = mujoco.mj_geomDistance(model, data, int(of_object), geom, 1.0, ends)
        place[row, :3] = data.geom_xpos[of_object] + (1 + 0.003 / apart) * (ends[3:] - ends[:3])
        data.qpos[world.object_at :][:3] = place[row, :3]
        mujoco.mj_fwdPosition(model, data)
        poses.append(transform(data.geom_xmat.reshape(-1, 3, 3), data.geom_xpos))
        for column, unit in zip(inertia[row], np.eye(model.nv)[dofs], strict=True):
            mujoco.mj_mulM(model, data, column, unit)
    for rows in (drake, other):
        rows.place(root, values, place)
    plant = drake._plant
    at = [plant.plant.GetJointByName(f"hand/{name}").velocity_start() for name in JOINTS]
    context = plant.diagram.CreateDefaultContext()
    of_plant = plant.plant.GetMyMutableContextFromRoot(context)
    for row in range(count):
        plant.start.SetPoseInParentFrame(of_plant, rigid(transform_from_pose(root[row])))
        plant.plant.SetPositionsAndVelocities(of_plant, drake._moving[row])
        query = plant.plant.get_geometry_query_input_port().Eval(of_plant)
        for identity, geom in plant.geoms.items():
            np.testing.assert_allclose(query.GetPoseInWorld(identity).GetAsMatrix4(), poses[row][geom], atol=1e-9)
        found = plant.plant.CalcMassMatrix(of_plant)[np.ix_(at, at)]
        np.testing.assert_allclose(found, inertia[row][:, dofs], atol=1e-9)
    found, expected = (rows.touching(np.arange(count)) for rows in (drake, other))
    np.testing.assert_array_equal(found.links, expected.links)
    alone, exact = expected.links.sum(axis=1) == 1, np.array(np.isin(model.geom_type[geoms], EXACT).tolist() * 4)
    assert alone[exact].sum() > 6 and alone[~exact].sum() > 6 and found.links.any(axis=0).all()
    np.testing.assert_allclose(found.depth[alone], 0.003, atol=6e-4)
    np.testing.assert_allclose(found.depth[alone & exact], 0.003, atol=1e-6)
    np.testing.assert_allclose(found.depth_table, expected.depth_table, atol=1e-4)
    assert (found.depth_table > 0.01).any() and (found.depth_table == 0).any()


def test_dry_friction_of_a_joint_stops_it() -> None:
    """At rest below the friction, and where the servo no longer overcomes it."""
    servos = LEFT.replace("</actuator>", '<position joint="right" kp="1"/></actuator>')
    rough = model(TIED.format(more='frictionloss="0.2"'), NAMES, servos)
    assert abs(driven("drake", rough, 0.0, 0.15)[2]) < 0.01
    assert driven("drake", rough, 0.0, 0.6, steps=1200)[2] == pytest.approx(0.4, abs=0.01)


@pytest.mark.parametrize(
    ("geom", "more", "count"),
    [
        ("", "", 21),
        ("", '<contact><exclude body1="twin" body2="end"/><exclude body1="twin" body2="left"/></contact>', 19),
        ('contype="2" conaffinity="2"', "", 16),
        ('contype="2" conaffinity="1"', "", 21),
        ('contype="0" conaffinity="0"', '<contact><pair geom1="twin" geom2="left"/></contact>', 16),
    ],
)
def test_pairs_that_may_touch_are_as_in_mujoco(geom: str, more: str, count: int) -> None:
    """Within so large a margin all pairs are contacts, but for those that are never tried.

    A part of the palm comes after the fingers that hang from it.
    """
    tree = TIED.format(more="").replace('<geom size="0.01" pos="0 0 0.02"/>', '<geom size="0.01"/>')
    for name in ("left", "twin"):
        place = tree.index("<geom", tree.index(f'name="{name}"')) + len("<geom")
        tree = f'{tree[:place]} name="{name}" {geom if name == "twin" else ""}{tree[place:]}'
    tree = tree.removesuffix("</body>") + '<body name="rim" pos="0 0 -0.05"><geom size="0.005"/></body></body>'
    compiled = build_world(model(tree, NAMES, more, LEFT), ball(), Task(DEXGRASPBENCH)).model
    compiled.geom_margin[:] = compiled.pair_margin[:] = 10.0
    data = mujoco.MjData(compiled)
    mujoco.mj_forward(compiled, data)
    found = {tuple(sorted(pair)) for pair in touching_pairs(compiled)}
    assert found == {tuple(sorted(pair)) for pair in data.contact.geom.tolist()} and len(found) == count
