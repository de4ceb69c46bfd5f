"""The benchmark of validation: both ways come to the same verdicts, and it says what they cost."""

from grasp_refine.scene.protocols.dexgraspbench import DEXGRASPBENCH
from grasp_refine.scene.task import Task
from grasp_refine.validation.engines.mujoco.world import build_world
from grasp_refine.validation.simulation import simulate
from grasp_refine_apps.bench.simulation import plain
from gripper import around, ball, gripper


def test_a_plain_loop_and_the_batch_agree() -> None:
    world = build_world(gripper(), ball(), Task(DEXGRASPBENCH))
    verdicts = []
    for force in (0.5, 3.0):
        held = simulate(world, around(force)).success[0]
        assert plain(world, around(force)) == held
        verdicts.append(bool(held))
    assert verdicts == [False, True]
