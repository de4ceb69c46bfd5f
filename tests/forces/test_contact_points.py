"""Contacts of flat faces: forces at corners make torques, gaps turn faces onto each other, exact derivatives."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from compiled import COMPILED
from grasp_refine.collision.query import query
from grasp_refine.core.se3 import exp_se3
from grasp_refine.forces.quality import quality
from grasp_refine.forces.squeeze import contacts, grasp_forces, squeezed
from grasp_refine.forces.wrench import LEVER_M
from grasp_refine.hands.hand import Hand
from grasp_refine.objects.object import Object, load_object
from grasp_refine.refinement import force_closure_search
from grasp_refine.refinement.config import Config
from grasp_refine.refinement.grasp_problem import GraspProblem
from grasp_refine.refinement.objective import Objective
from grasp_refine.refinement.refine import refine
from grasp_refine.refinement.solvers.descent import Descent
from grasp_refine.refinement.solvers.iterate import Point
from grasp_refine.refinement.solvers.levenberg_marquardt import LevenbergMarquardt
from grasp_refine.refinement.terms.weights import Weights, term_kinds
from grasp_refine.scene.contact_selection import ContactSelection
from grasp_refine.scene.goal import goal_of
from grasp_refine.scene.hand_object import HandObject
from grasp_refine.scene.scene import Scene
from made_hands import link, made_hand, slide, solid

BOX_JAW, ROUND_JAW = "box 0.02 0.01 0.04", "sphere 0.005"


def jaws(tmp_path, shape: str = BOX_JAW) -> Hand:
    """A palm and two jaws that open along y; joint values are the distances of the faces from its middle."""
    sides = {"left": 1, "right": -1}
    return replace(
        made_hand(
            tmp_path,
            link("palm"),
            *(link(name, solid(shape, (0, 0.005 * y, 0.03))) for name, y in sides.items()),
            *(
                slide(f"{name}_joint", "palm", name, axis=(0, y, 0), limits=(0, 0.06), effort=60)
                for name, y in sides.items()
            ),
            name="jaws",
            candidates=1024,
        ),
        patches=True,
    )


@pytest.fixture(name="block")
def the_block(tmp_path) -> Object:
    import trimesh

    path = tmp_path / "block.obj"
    trimesh.creation.box([0.05, 0.04, 0.06]).export(path)
    return load_object(path)


def gripping(*twists: list[float]) -> tuple[np.ndarray, np.ndarray]:
    """Grasps of the block whose hands are moved by twists at its centre."""
    T = np.tile(np.eye(4), (len(twists), 1, 1))
    T[:, 2, 3] = -0.03
    return exp_se3(np.array(twists)) @ T, np.full((len(twists), 2), 0.02)


def points_of(hand: Hand, obj: Object, T: np.ndarray, q: np.ndarray):
    prepared = HandObject.of(Scene(hand, obj, T, q))
    frames = prepared.chain(T, q)
    T_link = frames.T_world_link
    witness = query(prepared.pairs, T_link, np.broadcast_to(np.eye(4), T_link.shape))
    return contacts(hand, obj, prepared.chain.links, witness, T_link), frames, witness, prepared


def test_two_flat_jaws_have_eight_corners_and_balance_any_torque(tmp_path, block: Object):
    T, q = gripping([0.0] * 6)
    points, *_ = points_of(jaws(tmp_path), block, T, q)
    there = np.isfinite(points.point[0, :, 0])
    assert there.sum() == 8
    expected = [[x, y, z] for x in (-0.01, 0.01) for y in (-0.02, 0.02) for z in (-0.02, 0.02)]
    np.testing.assert_allclose(sorted(points.point[0, there].round(9).tolist()), expected, atol=1e-9)
    np.testing.assert_allclose(points.normal[0, there][:, 1], -np.sign(points.point[0, there, 1]), atol=1e-9)
    # Two points cannot make a torque about the line between them, nor more than friction and width about others.
    for axis, flat, rounded in ((0, True, False), (1, True, False), (2, True, False)):
        load = np.zeros((1, 1, 6))
        load[0, 0, 3 + axis] = 0.0011 / LEVER_M
        for shape, balanced in ((BOX_JAW, flat), (ROUND_JAW, rounded)):
            points, *_ = points_of(jaws(tmp_path, shape), block, T, q)
            residual = points.forces_under(load, np.zeros(3), axes=np.eye(3)[None], friction=0.15).residual
            if axis == 1 or shape == BOX_JAW:
                assert (residual[0, 0] < 1e-3) == balanced, (axis, shape)
    # Torsion is at most friction times pressure times the mean distance of the corners.
    reach = 0.15 * np.cos(np.pi / 8) * np.hypot(0.01, 0.02)
    load = np.zeros((1, 1, 6))
    load[0, 0, 4] = 2.0 * reach / LEVER_M
    points, *_ = points_of(jaws(tmp_path), block, T, q)
    residual = points.forces_under(load, np.zeros(3), axes=np.eye(3)[None], friction=0.15).residual[0, 0]
    assert residual == pytest.approx(reach / LEVER_M, rel=0.09), "between an octagon's edges and its corners"


def test_the_corners_of_a_link_press_together_as_much_as_one_contact(tmp_path, block: Object):
    """A push along the closing axis needs the other jaw as much as at points; a single link has all of the pressure."""
    T, q = gripping([0.0] * 6, [0.002, 0, 0.004, 0, 0.1, 0])
    load = np.zeros((2, 2, 6))
    load[:, 0, 1], load[:, 1] = 0.2, [0.1, -0.15, 0.05, 0, 0, 0.1]
    flat, _, witness, prepared = points_of(jaws(tmp_path), block, T, q)
    given = {"axes": np.tile(np.eye(3), (2, 1, 1)), "friction": 0.15}
    found = flat.forces_under(load, np.zeros(3), **given)
    total = np.stack([(found.pressure * (flat.link == k)[:, None]).sum(axis=-1) for k in range(2)], axis=-1)
    np.testing.assert_allclose(total, 0.5, atol=1e-4)
    np.testing.assert_allclose(found.residual[:, 0], 0.2, atol=1e-3)
    alone = np.isin(flat.link, [0])
    left = replace(flat, point=np.where(alone[..., None], flat.point, np.nan))
    assert (left.forces_under(load, np.zeros(3), **given).pressure.sum(axis=-1) > 0.999).all()


def test_forces_of_a_squeeze_do_the_work_of_its_torques(tmp_path, block: Object):
    hand = jaws(tmp_path)
    T, q = gripping([0.004, 0, 0.003, 0, 0.2, 0])
    scene = Scene(hand, block, T, q)
    found = squeezed(scene, total=1.0)
    kp = hand.actuator.kp
    np.testing.assert_allclose((q - found) * kp, [[0.5, 0.5]], atol=1e-6)


def test_grasps_without_patches_do_not_depend_on_grasps_with_patches(tmp_path, block: Object):
    hand = jaws(tmp_path)
    T, q = gripping([0.0] * 6, [0, 0, 0, 0, 0, 0.5], [0.001, 0, 0, 0.02, 0.3, 0.03])
    together, frames, witness, prepared = points_of(hand, block, T, q)
    assert together.patched.tolist() == [True, False, True]
    all_forces = grasp_forces(together, block, np.tile(np.eye(3), (3, 1, 1)))
    judged = quality(hand, block, prepared.chain, frames, witness)
    for i in range(3):
        alone, frames, witness, _ = points_of(hand, block, T[i : i + 1], q[i : i + 1])
        one = grasp_forces(alone, block, np.eye(3)[None])
        assert (one.local[0] == all_forces.local[i]).all() and one.residual[0] == all_forces.residual[i]
        assert quality(hand, block, prepared.chain, frames, witness).score[0] == judged.score[i]


def problem(hand: Hand, obj: Object, T: np.ndarray, q: np.ndarray, **weights: float) -> GraspProblem:
    scene = Scene(hand, obj, T, q)
    prepared = HandObject.of(scene)
    config = Config()
    goal = goal_of(scene, config.contact_selection, prepared)
    return GraspProblem(scene, goal, replace(config, weights=replace(config.weights, **weights)), prepared)


def gradients(of: GraspProblem, point: Point) -> tuple[np.ndarray, np.ndarray]:
    """Gradients (M, 8) of the losses of M grasps: by their rows, and by central differences."""
    member = np.arange(len(point.q))
    linear = of.linearize(member, point, of.evaluate(member, point, None), np.ones(len(member)))
    differences = np.empty((len(member), 8))
    for k in range(8):
        dx = np.zeros((len(member), 8))
        dx[:, k] = 1e-6
        ahead, behind = (of.evaluate(member, of.integrate(member, point, sign * dx), None).loss for sign in (1, -1))
        differences[:, k] = (ahead - behind) / 2e-6
    return 2.0 * np.einsum("mrd,mr->md", linear.jacobian, linear.residual), differences


def test_corners_of_a_link_count_together_as_much_as_its_point(tmp_path, block: Object):
    """At gaps of 1 mm, however many corners a patch has; a link that is no contact link keeps its clearance."""
    hand = jaws(tmp_path)
    hand = replace(hand, contacts=tuple(contact for contact in hand.contacts if contact.link == "left"))
    # All of the jaws, and a strip of 0.2 mm of them.
    T, q = gripping([0.0] * 6, [0.0348, 0, 0, 0, 0, 0])
    scene = Scene(hand, block, T, q + 1e-3)
    weights = Weights(**{**dict.fromkeys(term_kinds(), 0.0), "contact": 1.0})
    of = GraspProblem(scene, goal_of(scene, ContactSelection()), Config(weights=weights, clearance=4e-4))
    known = of.evaluate(np.arange(2), Point(T, q + 1e-3), None)
    np.testing.assert_array_equal(np.sort(known.patches.faces.count, axis=1)[:, 2:], [[4, 4], [2, 2]])
    np.testing.assert_allclose(known.loss, 2.0 * (1e-3**2 + 6e-4**2), rtol=1e-6)


def test_gaps_of_corners_have_the_derivative_of_their_squares(tmp_path, block: Object):
    T, q = gripping([0.002, 0, 0, 0.03, 0.1, 0.02], [0.0, 0.0, 0.021, 0.0, -0.3, 0.05])
    q = q + 0.001
    of = problem(jaws(tmp_path), block, T, q, penetration=0.0, self_penetration=0.0, wrench=0.0)
    member, point = np.arange(2), Point(T, q)
    known = of.evaluate(member, point, None)
    assert (known.patches.faces.count > 0).sum() == 4
    gradient, differences = gradients(of, point)
    np.testing.assert_allclose(gradient, differences, atol=1e-6, rtol=1e-5)


@pytest.mark.parametrize("transport", [False, True])
def test_descent_and_adam_have_the_loss_and_the_derivative_of_corners(tmp_path, block: Object, transport: bool):
    T, q = gripping([0.002, 0, 0, 0.03, 0.1, 0.02], [0.0, 0.0, 0.021, 0.0, -0.3, 0.05])
    hand, member, point = jaws(tmp_path), np.arange(2), Point(T, q + 0.001)
    parts = []
    for patches in (True, False):
        alone = dict(penetration=0.0, self_penetration=0.0, wrench=0.0)
        of = problem(replace(hand, patches=patches), block, point.T, point.q, **alone)
        known = Objective(of.scene, of.goal, replace(of.config, solver=Descent(transport=transport))).evaluate(
            member, point, None
        )
        np.testing.assert_allclose(known.loss, of.evaluate(member, point, None).loss, rtol=1e-9)
        # A body gradient has half of the derivative in rotations.
        v, w = (T[:, :3, :3] @ known.gradient[:, part, None] for part in (slice(3), slice(3, 6)))
        in_world = [v[..., 0], 2.0 * w[..., 0]]
        parts.append((known.loss, np.concatenate([*in_world, known.gradient[:, 6:]], axis=1), gradients(of, point)[1]))
    # The part of the corners: contact kinematics smooth that of witness points.
    loss, gradient, differences = (with_patches - without for with_patches, without in zip(*parts, strict=True))
    assert (loss > 1e-7).all()
    np.testing.assert_allclose(gradient, differences, atol=1e-6, rtol=1e-4)


def test_balance_at_corners_has_the_derivative_of_finite_differences(tmp_path, block: Object):
    T, q = gripping([0.011, 0, 0.018, 0.004, 0.2, 0.003], [0.013, 0.0, 0.004, 0.002, -0.3, 0.005])
    of = problem(jaws(tmp_path), block, T, q, penetration=0.0, self_penetration=0.0, contact=0.0, wrench=1.0)
    member, point = np.arange(2), Point(T, q)
    known = of.evaluate(member, point, None)
    assert known.loss.min() > 1e-4
    gradient, differences = gradients(of, point)
    tolerance = 2e-4 if COMPILED else 1e-3
    np.testing.assert_allclose(gradient, differences, atol=tolerance * np.abs(gradient).max())


@pytest.mark.parametrize("angle", [0.03, 0.15])
def test_refinement_turns_faces_onto_each_other(tmp_path, block: Object, angle: float):
    rng = np.random.default_rng(0)
    T, q = gripping(*np.concatenate([0.003 * rng.normal(size=(8, 3)), angle * rng.normal(size=(8, 3)) / 1.7], axis=1))
    hand = jaws(tmp_path)
    scene = Scene(hand, block, T, q + 0.003)
    found = refine(scene, Config(starts=1))
    points, *_ = points_of(hand, block, found.T_world_root, found.q)
    assert points.patched.all() and np.abs(points.gap).max() < 2e-5
    normal = found.T_world_root[:, :3, 1]
    np.testing.assert_allclose(np.abs(normal).max(axis=1), 1.0, atol=1e-6)


CLOSED = Config(weights=replace(Config().weights, wrench=0.0))


@pytest.mark.parametrize("config", [Config(starts=1), CLOSED, replace(CLOSED, solver=LevenbergMarquardt(iterations=8))])
def test_parallel_jaws_touch_a_wedge_as_flat_as_they_can(tmp_path, config: Config):
    """Also where iterations run out before faces lie as flat as they can; their losses are without gaps of corners."""
    half = np.radians(2.0)
    corners = np.array([[x, y, z] for x in (-0.025, 0.025) for y in (-0.02, 0.02) for z in (-0.03, 0.03)])
    corners[:, 1] *= 1.0 + corners[:, 0] / 0.02 * np.tan(half)
    import trimesh

    path = tmp_path / "wedge.obj"
    trimesh.convex.convex_hull(corners).export(path)
    wedge, hand = load_object(path), jaws(tmp_path)
    T, q = gripping([0.001, 0, 0, 0, 0, 0.015], [0, 0.001, 0.002, 0.02, 0.1, -0.01], [0, 0, 0, 0.02, 0, 0.05])
    found = refine(Scene(hand, wedge, T, q + 0.003), config)
    assert found.labels.tolist() == ["converged"] * 3 and found.loss[:, 1].max() < 1e-9
    points, _, witness, _ = points_of(hand, wedge, found.T_world_root, found.q)
    assert points.patched.all() and np.abs(witness.distance[:, :2]).max() < 1e-5
    # Jaws that are parallel share the angle between the faces about evenly.
    normal = found.T_world_root[:, :3, 1]
    faces = np.stack([[-np.sin(half), side * np.cos(half), 0.0] for side in (-1, 1)])
    tilt = np.degrees(np.arccos(np.abs(normal @ faces.T)))
    np.testing.assert_allclose(tilt, 2.0, atol=0.5)


def test_two_points_are_not_left_for_others_that_balance_a_little_better(
    tmp_path, block: Object, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(force_closure_search, "GOOD_SCORE", -1.0)  # so that all starts are tried
    T, q = gripping([0.006, 0, 0.004, 0, 0, 0.02])
    scene = Scene(jaws(tmp_path, ROUND_JAW), block, T, q + 0.001)
    once, often = (refine(scene, Config(starts=starts)) for starts in (1, 6))
    assert often.starts.tolist() == [6]
    np.testing.assert_array_equal(often.T_world_root, once.T_world_root)


def test_nothing_is_looked_for_where_no_link_is_flat(tmp_path, block: Object):
    T, q = gripping([0.0] * 6)
    points, *_ = points_of(jaws(tmp_path, ROUND_JAW), block, T, q)
    assert points.patches is None and points.point.shape[1] == 2
