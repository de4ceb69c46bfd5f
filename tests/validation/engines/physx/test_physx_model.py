"""Worlds in PhysX against the same worlds in MuJoCo and closed forms: poses, hulls, tendons, couplings and pairs."""

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from engine_rows import ORIGIN, both, driven
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.scene.plane import Plane
from grasp_refine.scene.protocols.tabletop import TABLETOP
from grasp_refine.scene.task import Task
from grasp_refine.validation.engines.mujoco.stepping import Conditions
from grasp_refine.validation.engines.mujoco.world import build_world
from grasp_refine.validation.engines.physx.shapes import let_collide, material_of, shape_of
from grasp_refine.validation.engines.simulations import OBJECT_GEOM
from gripper import ball
from rich_hands import model, random_poses, unlimited


def test_bodies_are_where_mujoco_has_them_and_overlap_as_deeply() -> None:
    """An object at each geom in turn, at random joint values and poses of the root."""
    world = build_world(unlimited(), ball(), Task(TABLETOP, table=Plane((0.6, 0.0, 0.8), offset=-0.05)))
    model, rng = world.model, np.random.default_rng(0)
    geoms = np.flatnonzero(np.array(world.link_of_geom) >= 0)
    count, data = 4 * len(geoms), mujoco.MjData(world.model)
    root, values = random_poses(count, 1), rng.uniform([-1, -1, -1, -0.01], [1, 1, 1, 0.01], (count, 4))
    place, ends = np.tile(ORIGIN, (count, 1)), np.zeros(6)
    (of_object,) = np.flatnonzero(world.link_of_geom == OBJECT_GEOM)
    for row in range(count):
        data.qpos[world.root_at : world.root_at + 7], data.qpos[world.joints_at] = root[row], values[row]
        mujoco.mj_kinematics(model, data)
        geom = int(geoms[row % len(geoms)])
        data.qpos[world.object_at :][:3] = data.geom_xpos[geom] + rng.normal(size=3) * 0.1
        mujoco.mj_kinematics(model, data)
        apart = mujoco.mj_geomDistance(model, data, int(of_object), geom, 1.0, ends)
        place[row, :3] = data.geom_xpos[of_object] + (1 + 0.003 / apart) * (ends[3:] - ends[:3])
    found, expected = both("physx", world, Conditions.nominal(world, count))
    for rows in (found, expected):
        rows.place(root, values, place)
    found, expected = (rows.touching(np.arange(count)) for rows in (found, expected))
    # Where two surfaces graze each other, a polyhedron in place of an ellipsoid decides otherwise.
    assert (found.links != expected.links).sum() <= 1
    alone = expected.links.sum(axis=1) == 1
    assert alone.sum() > 12 and found.links.any(axis=0).all()
    # Ellipsoids and cylinders are polyhedra.
    np.testing.assert_allclose(found.depth[alone], 0.003, atol=6e-4)
    assert np.median(np.abs(found.depth[alone] - 0.003)) < 1e-5
    np.testing.assert_allclose(found.depth_table, expected.depth_table, atol=6e-4)
    assert (found.depth_table > 0.01).any() and (found.depth_table == 0).any()


FINGERS = """<body name="palm"><inertial pos="0 0 0" mass="1" diaginertia="0.01 0.01 0.01"/>
  <body name="base"><joint name="base" axis="0 1 0" {spring}/><geom size="0.01" pos="0 0 0.02"/>
    <body name="a" pos="0 0 0.04"><joint name="a" axis="0 1 0" {spring}/><geom size="0.01" pos="0 0 0.02"/>
      <body name="b" pos="0 0 0.04"><joint name="b" axis="0 1 0" {spring}/><geom size="0.01" pos="0 0 0.02"/></body>
    </body>
    <body name="c" pos="0.04 0 0.04"><joint name="c" axis="0 -1 0" {spring}/><geom size="0.01" pos="0 0 0.02"/></body>
  </body></body>"""
"""A finger of two joints and another one, on a third joint; springs of 0.5 N m/rad hold all."""


@pytest.mark.parametrize("weights", [{"a": 1.0, "b": 1.0}, {"a": -0.4, "b": 1.5}, {"b": 2.0, "c": -0.7}, {"c": 0.3}])
@pytest.mark.parametrize("force", [np.inf, 0.2])
def test_a_tendon_pulls_its_joints_by_weight_and_no_other(weights: dict[str, float], force: float) -> None:
    """Each spring gives by weight x tension / stiffness, where tension = kp (aim - length) up to its limit."""
    tree = FINGERS.format(spring='stiffness="0.5" damping="0.02" armature="1e-4"')
    terms = "".join(f'<joint joint="{name}" coef="{weight}"/>' for name, weight in weights.items())
    limit = f'forcerange="-{force} {force}"' if np.isfinite(force) else ""
    tendon = f'<tendon><fixed name="t">{terms}</fixed></tendon>'
    names = ("base", "a", "b", "c")
    hand = model(tree, names, tendon, f'<actuator><position tendon="t" kp="2" {limit}/></actuator>')
    squares = sum(weight**2 for weight in weights.values()) / 0.5
    tension = min(2 * 0.6 / (1 + 2 * squares), force)
    expected = [weights.get(name, 0.0) * tension / 0.5 for name in names]
    np.testing.assert_allclose(
        driven("physx", hand, 0.6, steps=1500), expected, atol=0.005 + 0.03 * np.abs(expected).max()
    )


@pytest.mark.parametrize(("leader", "follower"), [("a", "b"), ("b", "a"), ("a", "c")])
@pytest.mark.parametrize("ratio", [-1.0, 0.5, 1.5])
def test_a_coupling_transmits_torque_by_its_ratio(leader: str, follower: str, ratio: float) -> None:
    """A servo against the spring of the follower: kp (aim - q) = ratio x stiffness x ratio q."""
    tree = FINGERS.format(spring='damping="0.02" armature="1e-4"')
    tree = tree.replace(f'name="{follower}" axis', f'name="{follower}" stiffness="0.5" axis')
    coupling = f'<equality><joint joint1="{follower}" joint2="{leader}" polycoef="0 {ratio}"/></equality>'
    names = ("base", "a", "b", "c")
    servo = f'<actuator><position joint="{leader}" kp="2"/><position joint="base" kp="20"/></actuator>'
    hand = model(tree, names, coupling, servo)
    found = dict(zip(names, driven("physx", hand, 0.6, 0.0, steps=1000), strict=True))
    assert found[leader] == pytest.approx(2 * 0.6 / (2 + 0.5 * ratio**2), rel=0.04)
    assert found[follower] == pytest.approx(ratio * found[leader], abs=6e-3)


def test_hulls_keep_their_vertices_and_lie_hardly_inside() -> None:
    """Fingertips of 2 cm; in metres PhysX would drop vertices within 0.7 mm of a face."""
    rng = np.random.default_rng(0)
    points = rng.normal(size=(120, 3))
    points *= 0.01 / np.linalg.norm(points, axis=1, keepdims=True)
    spec = mujoco.MjSpec()
    spec.add_mesh(name="tip", uservert=points.ravel())
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname="tip")
    compiled = spec.compile()
    shape = shape_of(compiled, 0, np.eye(4), material_of(0.6))
    directions = Rotation.random(500, random_state=0).as_matrix()[:, 0]
    reach = (directions @ (np.asarray(shape.vertices) * shape.scale).T).max(axis=1)
    expected = (directions @ compiled.mesh_vert.T).max(axis=1)
    np.testing.assert_allclose(reach, expected, atol=2e-5)


def test_only_pairs_that_may_touch_do() -> None:
    """In a scene of spheres all in one place, the pairs that PhysX reports are the pairs asked for."""
    rng, count = np.random.default_rng(0), 30
    pairs = [(a, b) for a in range(count) for b in range(a) if rng.uniform() < 0.3]
    spec = mujoco.MjSpec()
    for _ in range(count):
        spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.01, 0, 0])
    compiled = spec.compile()
    shapes = [shape_of(compiled, geom, np.eye(4), material_of(0.6)) for geom in range(count)]
    let_collide(shapes, pairs)
    groups = [shape.collision_groups for shape in shapes]
    met = {(a, b) for a in range(count) for b in range(a) if groups[a][0] & groups[b][1] or groups[a][1] & groups[b][0]}
    assert met == set(pairs)
    with pytest.raises(GraspRefineError, match="32"):
        let_collide([*shapes, *shapes], [(a, b) for a in range(60) for b in range(a)])
