"""Options become the settings of the library: defaults are its own, each reaches it, and units are converted once."""

from collections.abc import Iterator
from dataclasses import asdict, fields, replace
from math import inf, radians
from typing import Any

import pytest

from grasp_refine.refinement.config import Config
from grasp_refine.refinement.max_move import MaxMove
from grasp_refine.refinement.terms.weights import Weights
from grasp_refine.results.document import settings
from grasp_refine.scene.protocols.dexgraspbench import DEXGRASPBENCH
from grasp_refine.scene.protocols.registry import PROTOCOLS
from grasp_refine.scene.task import Task
from grasp_refine_apps.commands.inputs import Inputs
from grasp_refine_apps.commands.options import parse
from grasp_refine_apps.commands.run import Run
from grasp_refine_apps.commands.settings import Settings
from grasp_refine_apps.commands.simulation_options import Robustness, Simulation

FIRST_ORDER = Settings(solver="descent")
OPTIONS: dict[str, tuple[Settings, Any]] = {
    "solver": (Settings(), "descent"), "iterations": (Settings(), 7), "starts": (Settings(), 3),
    "prefer": (Settings(), "balanced"), "confidence": (Settings(), 0.9),
    "max_move": (Settings(), (0.1, 0.2, inf)), "seconds": (Settings(), 2.0), "geometry_only": (Settings(), True),
    "tolerance": (Settings(), 1e-9), "margin": (Settings(), 1e-3), "clearance": (Settings(), 2e-3),
    "pressure": (Settings(), 9.0), "reach": (Settings(), 0.05), "other_link_distance": (Settings(), 0.03),
    "contacts": (Settings(), ("thumb",)), "width": (Settings(), 5), "seed": (Settings(), 3),
    "weights": (Settings(), Weights(penetration=2.0)), "derivative": (FIRST_ORDER, "distance"),
    "neighborhood": (FIRST_ORDER, "fixed"), "transport": (FIRST_ORDER, True), "dtype": (FIRST_ORDER, "float32"),
    "freeze": (Settings(), ("palm",)),
}  # fmt: skip
"""Option -> options before, and another value."""


def test_without_options_the_settings_are_as_in_the_library():
    assert Settings().config() == Config()
    assert Simulation().changed(DEXGRASPBENCH) == DEXGRASPBENCH and Inputs().read_task() == Task()
    assert Inputs(protocol="strict").read_task() == Task(PROTOCOLS["strict"])


def methods() -> Iterator[tuple[str, Settings]]:
    """Yield the field of each method, with options that choose it."""
    for name in ("levenberg_marquardt", "descent", "adam"):
        yield name, Settings(solver=name.replace("_", "-"))
    for name in ("contact_kinematics", "distance", "direction", "analytical", "zeroth_order", "finite_difference"):
        yield name, replace(FIRST_ORDER, derivative=name.replace("_", "-"))
    for name in ("adaptive", "fixed", "neighbor"):
        yield name, replace(FIRST_ORDER, derivative="distance", neighborhood=name)


def test_every_option_reaches_the_settings():
    """An option that nobody reads would be forgotten in silence."""
    chosen = dict(methods())
    others = {"device", "scales", "rigid"}
    assert {*OPTIONS, *chosen, *others} == {field.name for field in fields(Settings)}
    for name, (before, value) in OPTIONS.items():
        assert settings(replace(before, **{name: value}).config()) != settings(before.config()), name
    for name, before in chosen.items():
        method = getattr(before, name)
        for field, value in asdict(method).items():
            if isinstance(value, float) and field not in ("momentum", "first", "second"):
                changed = replace(before, **{name: replace(method, **{field: 0.5 * value or 0.1})})
                assert settings(changed.config()) != settings(before.config()), (name, field)
    stay = Weights(stay_near=1.0)
    scaled = Settings(weights=stay, scales=replace(Settings().scales, rotation=2.0))
    assert scaled.config().scales.rotation == 2.0 != Settings(weights=stay).config().scales.rotation


def test_numbers_keep_their_place_and_unit():
    config = Settings(iterations=7, max_move=(0.1, 0.2, inf), reach=0.5, geometry_only=True, seconds=3.0).config()
    assert config.max_move == MaxMove(translation=0.1, rotation=0.2, joints=inf)
    # Links within reach are among those that are searched.
    assert (config.solver.iterations, config.seconds, config.contact_selection.farthest) == (7, 3.0, 0.5)
    assert config.weights == replace(Config().weights, wrench=0.0)
    first_order = replace(FIRST_ORDER, derivative="distance", seed=3, iterations=7, transport=True).config()
    assert (first_order.solver.iterations, first_order.solver.transport, first_order.derivative.seed) == (7, True, 3)
    assert (first_order.tolerance, Settings().config().tolerance) == (1e-7, Config.tolerance)
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
