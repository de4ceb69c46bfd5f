"""Options become the settings of the library: defaults are its own, and units are converted once."""

from math import inf, radians

import pytest

from grasp_refine.refinement.config import Config
from grasp_refine.scene.protocols.dexgraspbench import DEXGRASPBENCH
from grasp_refine.scene.protocols.registry import PROTOCOLS
from grasp_refine.scene.task import Task
from grasp_refine_apps.commands.inputs import Inputs
from grasp_refine_apps.commands.options import parse
from grasp_refine_apps.commands.run import Run
from grasp_refine_apps.commands.settings import Settings
from grasp_refine_apps.commands.simulation_options import Robustness, Simulation


def test_without_options_the_settings_are_as_in_the_library():
    assert Settings().config() == Config()
    assert Simulation().changed(DEXGRASPBENCH) == DEXGRASPBENCH and Inputs().read_task() == Task()
    assert Inputs(protocol="strict").read_task() == Task(PROTOCOLS["strict"])


def test_what_a_method_does_not_choose_itself_reaches_it():
    config = Settings(solver="descent", derivative="distance", seed=3, iterations=7, transport=True).config()
    assert (config.solver.iterations, config.solver.transport, config.derivative.seed) == (7, True, 3)
    assert (config.tolerance, Settings().config().tolerance) == (1e-7, Config.tolerance)
    least_squares = Settings(iterations=7, max_move=(0.1, 0.2, inf), reach=0.5, geometry_only=True).config()
    assert least_squares.solver.iterations == 7 and least_squares.weights.wrench == 0
    move = least_squares.max_move
    assert (move.translation, move.rotation, move.joints) == (0.1, 0.2, inf)
    # Links within reach are among those that are searched.
    assert least_squares.contact_selection.farthest == 0.5


def test_durations_and_angles_have_the_units_of_the_library():
    assert Simulation(seconds=0.4).changed(DEXGRASPBENCH).checks == 2
    changed = Inputs(mass=0.5, friction=0.2).read_task().named_protocol
    assert changed is not None and (changed.mass, changed.friction) == (0.5, 0.2)
    noise = Robustness(noise=3, noise_offset=0.01, noise_degrees=90.0).checks(None).noise
    assert (noise.count, noise.offset, noise.turn) == pytest.approx((3, 0.01, radians(90.0)))


@pytest.mark.parametrize("separator", [",", " ", ", "])
def test_several_values_are_separated_by_commas_or_spaces(separator: str):
    index, limits = (separator.join(values).split() for values in (("2", "0"), ("0.1", "0", "3")))
    run = parse(Run, "run", ["--index", *index, "--max-move", *limits])
    assert (run.inputs.index, run.settings.max_move) == ((2, 0), (0.1, 0.0, 3.0))
