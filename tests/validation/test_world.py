"""The world that a hand is put into: what can touch what there, and what is said where there can be none."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from mujoco.batch import Batch

from grasp_refine.core.errors import GraspRefineError
from grasp_refine.objects.object import load_object
from grasp_refine.scene.plane import Plane
from grasp_refine.scene.protocols.dexgraspbench import DEXGRASPBENCH
from grasp_refine.scene.protocols.tabletop import TABLETOP
from grasp_refine.scene.task import Task
from grasp_refine.validation.engines.mujoco.hand_model import HandModel
from grasp_refine.validation.engines.mujoco.stepping import Conditions
from grasp_refine.validation.engines.mujoco.world import TABLE, build_world
from grasp_refine.validation.simulation import close, simulate
from gripper import around, ball, gripper
from refusals import refused


def with_bits(left: tuple[int, int], right: tuple[int, int]) -> HandModel:
    """The gripper, whose plates have these contype and conaffinity."""
    made = gripper()
    for geom, (contype, conaffinity) in zip(made.spec.geoms, (left, right), strict=True):
        geom.contype, geom.conaffinity = contype, conaffinity
    return made


@pytest.mark.parametrize("bits", [(1, 1), (0, 1), (4, 0), (2, 8), (-(2**31), 0)])
def test_object_and_table_touch_whatever_can_touch_anything(bits: tuple[int, int]) -> None:
    """A hand with bits other than the first once closed through the object, and nothing said so."""
    held = simulate(build_world(with_bits(bits, bits), ball(), Task(DEXGRASPBENCH)), around(4.0))
    assert held.success.all() and held.contacts_squeeze.all()
    model = build_world(with_bits(bits, bits), ball(), Task(TABLETOP)).model
    data = mujoco.MjData(model)
    # The hand, upside down, in the table.
    data.qpos[model.joint("hand").qposadr[0] :][:7] = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0]
    mujoco.mj_forward(model, data)
    table = model.geom(TABLE).id
    plates = [geom for geom in range(model.ngeom) if model.body(model.geom_bodyid[geom]).name.startswith("hand/")]
    assert {g for pair in data.contact.geom if table in pair for g in pair} >= {table, *plates}


def test_what_is_only_seen_touches_nothing() -> None:
    world = build_world(with_bits((1, 1), (0, 0)), ball(), Task(DEXGRASPBENCH))
    assert world.links == ("left plate",)
    assert not simulate(world, around(4.0)).success.any()


@pytest.mark.parametrize(
    ("multiccd", "patches", "several"),
    [(False, True, False), (True, False, True), (None, True, True), (None, False, False)],
)
def test_protocol_or_else_hand_says_in_how_many_points_pieces_touch(
    multiccd: bool | None, patches: bool, several: bool
) -> None:
    """Flat plates on a flat box: one point each, or the corners of the face."""
    box = load_object("box:0.06,0.04,0.05", unit="m", candidates=16)
    hand = replace(gripper(), patches=patches)
    world = build_world(hand, box, Task(replace(DEXGRASPBENCH, multiccd=multiccd)))
    assert world.protocol.multiccd is several
    assert ("faces touch in several points" in world.protocol.label) is several
    points: list[int] = []

    def count(batch: Batch) -> None:
        data = mujoco.MjData(world.model)
        batch.get_data(0, data)
        mujoco.mj_forward(world.model, data)
        points.append(data.ncon)

    close(world, around(4.0), Conditions.nominal(world, 1), on_step=count)
    assert points[-1] == (8 if several else 2)


def test_a_table_is_as_steep_as_it_is_said() -> None:
    """A table with another normal than z once lay level, through the same point."""
    normal = np.array([0.6, 0.0, 0.8])
    model = build_world(gripper(), ball(), Task(TABLETOP, table=Plane(tuple(normal), offset=-0.05))).model
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    np.testing.assert_allclose(data.geom(TABLE).xmat.reshape(3, 3)[:, 2], normal, atol=1e-12)
    assert data.geom(TABLE).xpos @ normal == pytest.approx(-0.05)


def test_a_hand_that_cannot_touch_the_object_is_refused() -> None:
    with refused(GraspRefineError, "sphere:0.03", "conaffinity 0"):
        build_world(with_bits((0, 0), (0, 0)), ball(), Task(DEXGRASPBENCH))


@pytest.mark.parametrize(("radius", "mass"), [(0.03, 1e-16), (1e-9, 0.1)])
def test_an_object_that_is_too_light_or_too_small_names_the_options(radius: float, mass: float) -> None:
    with refused(GraspRefineError, "mass and inertia of moving bodies", "`mass`", "`scale`") as caught:
        build_world(gripper(), ball(radius), Task(replace(DEXGRASPBENCH, mass=mass)))
    assert "Error:" not in str(caught.value)


def test_a_hand_that_weighs_nothing_does_not_blame_the_object() -> None:
    hand = gripper()
    hand.spec.geoms[0].mass = 0.0
    with refused(GraspRefineError, "mass and inertia", "'hand/left'") as caught:
        build_world(hand, ball(), Task(DEXGRASPBENCH))
    assert "`mass`" not in str(caught.value)
