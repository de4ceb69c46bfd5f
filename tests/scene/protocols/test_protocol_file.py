"""Protocols by name and out of a user's TOML: what a file says counts, and what it cannot mean is refused."""

from dataclasses import replace
from pathlib import Path

import pytest

from grasp_refine.core.errors import GraspRefineError
from grasp_refine.results.document import settings
from grasp_refine.scene.protocols.contact_model import ContactModel
from grasp_refine.scene.protocols.dexgraspbench import DEXGRASPBENCH
from grasp_refine.scene.protocols.noise import Noise
from grasp_refine.scene.protocols.protocol import Protocol
from grasp_refine.scene.protocols.protocol_file import load_protocol, protocol_of
from grasp_refine.scene.protocols.registry import PROTOCOLS
from grasp_refine.scene.task import Task
from grasp_refine.scene.task_spec import TaskSpec
from grasp_refine.validation.engines.mujoco.world import build_world
from grasp_refine.validation.simulation import simulate
from grasp_refine.validation.trials import Reason
from grasp_refine_apps.commands.simulation_options import Simulation
from gripper import around, ball, gripper
from refusals import assert_names, refused

TEXT = """
based_on = "strict"
mass = 2            # an integer is a number, too
directions = ["+x", "-z"]
required_share = 0.5
steepest = 0.5
[contact]
cone = "pyramidal"
[noise]
count = 3
"""

WANTED = replace(
    PROTOCOLS["strict"],
    name="mine",
    mass=2,
    directions=("+x", "-z"),
    required_share=0.5,
    steepest=0.5,
    contact=ContactModel(cone="pyramidal"),
    noise=Noise(count=3),
)


def written(folder: Path, text: str, name: str = "mine.toml") -> str:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return str(path)


def test_names_are_as_in_the_registry() -> None:
    assert all(load_protocol(name) is protocol for name, protocol in PROTOCOLS.items())
    with refused(GraspRefineError, "'soft'", *PROTOCOLS, ".toml"):
        load_protocol("soft")


def test_a_file_changes_what_it_says_and_keeps_the_rest(tmp_path: Path) -> None:
    assert load_protocol(written(tmp_path, TEXT)) == WANTED
    assert load_protocol(written(tmp_path, "", "Other.TOML")) == replace(DEXGRASPBENCH, name="Other", palm="rigid")
    assert load_protocol(written(tmp_path, 'name = "ours"')).name == "ours"


@pytest.mark.parametrize("protocol", [*PROTOCOLS.values(), WANTED])
def test_documents_keep_protocols_whole(protocol: Protocol) -> None:
    assert protocol_of(settings(protocol)) == protocol


def test_options_override_a_file(tmp_path: Path) -> None:
    path = written(tmp_path, "friction = 0.4\ndensity = 500.0\nsteps_per_check = 25")
    plain = TaskSpec(protocol=path).chosen_protocol(in_scene=False)
    assert plain is not None
    assert (plain.friction, plain.torsion, plain.density, plain.seconds) == (0.4, 0.02, 500.0, 1.0)
    spec = TaskSpec(protocol=path, friction=0.8, mass=0.3)
    other = Simulation(seconds=0.5).changed(spec.read_task().test(patches=False))
    assert (other.friction, other.torsion, other.mass, other.density) == (0.8, pytest.approx(0.04), 0.3, None)
    assert other.seconds == pytest.approx(0.5)
    with refused(GraspRefineError, "--seconds", "0.1", "0.25"):
        Simulation(seconds=0.25).changed(plain)


def test_the_soft_weld_is_of_files_that_ask_for_it(tmp_path: Path) -> None:
    assert load_protocol("dexgraspbench").palm == "soft weld"
    assert load_protocol(written(tmp_path, "mass = 0.5")).palm == "rigid"
    soft = load_protocol(written(tmp_path, 'palm = "soft weld"'))
    assert soft.palm == "soft weld" and soft.with_mass(0.5).palm == "rigid"
    for text in (soft.summary, soft.label):
        assert_names(text, "palm")
    assert "palm" not in soft.with_mass(0.5).summary


def test_a_file_is_simulated_as_it_says(tmp_path: Path) -> None:
    """Half of the friction needs twice the force; a file once passed its checks and changed nothing."""
    at = {friction: load_protocol(written(tmp_path, f"friction = {friction}")) for friction in (0.6, 0.3)}
    for friction, held in ((0.6, True), (0.3, False)):
        trials = simulate(build_world(gripper(), ball(), Task(at[friction])), around(1.2))
        across = [name[1] != "x" for name in trials.directions]
        assert ((trials.reason[:, across] == Reason.HELD) == held).all()


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("frictoin = 0.5", ("no key 'frictoin'", "friction", "based_on")),
        ("[contact]\nkone = 1", ("contact.kone", "cone", "impratio", "noslip_iterations")),
        ("[noise]\nnumber = 1", ("noise.number", "count", "offset", "turn")),
        ('friction = "high"', ("friction", "'high'")),
        ("friction = true", ("friction", "True")),
        ("friction = 0", ("friction must be above 0", "0")),
        ("friction = inf", ("friction", "inf")),
        ("friction = nan", ("friction", "nan")),
        ("mass = 1e300", ("mass", "1e+12")),
        (f"checks = {'9' * 40}", ("checks", "1e+12")),
        ("checks = 2.5", ("checks", "2.5")),
        ('directions = ["up"]', ("directions", "+x, -x, +y, -y, +z, -z", "up")),
        ('directions = "+x"', ("directions", "'+x'")),
        ("directions = [1]", ("directions",)),
        ("contact = 3", ("contact must be a table", "cone", "3")),
        ('[contact]\ncone = "round"', ("contact.cone", "elliptic", "pyramidal", "round")),
        ("[contact]\nimpratio = 0", ("contact.impratio", "0")),
        ("[noise]\ncount = -1", ("noise.count", "-1")),
        ('palm = "loose"', ("palm", "rigid", "soft weld", "loose")),
        ("required_share = 2", ("required_share must be at most 1", "2")),
        ("largest_mass = 0.5", ("largest_mass", "density")),
        ('based_on = "soft"', ("based_on", "'soft'", "dexgraspbench")),
        ("based_on = 3", ("based_on", "3", "dexgraspbench")),
        ('name = "strict"', ("name", "'strict'")),
        ("name = 3", ("name", "3")),
        ("friction = ", ("TOML",)),
    ],
)
def test_what_cannot_be_meant_is_refused_in_one_line(tmp_path: Path, text: str, named: tuple[str, ...]) -> None:
    path = written(tmp_path, text)
    with refused(GraspRefineError, path, *named) as caught:
        load_protocol(path)
    assert str(caught.value).startswith(f"{path}: ")


def test_a_file_that_is_missing_is_named(tmp_path: Path) -> None:
    with refused(GraspRefineError, "none.toml", "no such file"):
        load_protocol(str(tmp_path / "none.toml"))
