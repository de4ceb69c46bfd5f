"""What is told of weak grasps: the costliest shortcoming, with its push, link, contact or joint."""

import re
from dataclasses import replace

import numpy as np
import pytest

from grasp_refine.forces.quality import SHORTCOMINGS, Quality
from grasp_refine.results.weakness import direction_text, weaknesses
from grasp_refine.scene.demand import Demand

LINKS = ("palm", "thumb", "index")
JOINTS = ("thumb_base", "index_base")


def plain(**given: float) -> Quality:
    """One grasp without shortcomings but the given ones; the thumb is deepest, the index finger farthest."""
    one = {name: np.array([given.get(name, 0.0)]) for name in SHORTCOMINGS}
    return Quality(
        **{name: one[name] for name in ("slippery", "pushed", "deep", "open")},
        torque_share=np.array([1.0 + given["strained"] if "strained" in given else 0.0]),
        turn_share=np.array([1.0 + given["yielding"] if "yielding" in given else 0.0]),
        weakest_push=np.array([[0.0, -1.0, 0.0]]),
        deepest_link=np.array([1]),
        farthest_contact=np.array([2]),
        strained_joint=np.array([1]),
    )


@pytest.mark.parametrize(
    ("given", "named"),
    [
        ({"slippery": 0.4}, ("friction 0.1", "40%")),
        ({"pushed": 0.2}, ("-y",)),
        ({"deep": 0.3}, ("thumb", "3.0 mm")),
        ({"open": 0.4}, ("index",)),
        ({"strained": 0.5}, ("index_base", "150%")),
        ({"yielding": 4.0}, ("close together", "2.9 degrees")),
        ({"yielding": 9.0}, ("5.7 degrees or more",)),
        ({"pushed": 0.2, "deep": 1e-4}, ("-y",)),
    ],
)
def test_the_costliest_shortcoming_is_reported(given: dict[str, float], named: tuple[str, ...]) -> None:
    (text,) = weaknesses(plain(**given), LINKS, JOINTS)
    assert all(name in text for name in named)


@pytest.mark.parametrize("mass", [0.5, 2.0])
def test_heavy_objects_strain_and_turn_grasps_up_to_a_mass(mass: float) -> None:
    """The text is on the load of the task; friction, and the turn for each newton, are as they are."""
    demand = Demand(mass_kg=mass, friction=0.3)
    (strained,) = weaknesses(plain(strained=3.0), LINKS, JOINTS, demand=demand)
    assert "400%" in strained and re.search(r"carries at most ([\d.]+) kg", strained)
    # As much as it takes for a torque that the joint can just make, and a little more.
    most = float(re.search(r"carries at most ([\d.]+) kg", strained)[1])
    assert mass / 4.0 < most < 1.5 * mass / 4.0
    (turned,) = weaknesses(plain(yielding=4.0).under(demand.load), LINKS, JOINTS, demand=demand)
    assert "2.9 degrees for each newton" in turned
    assert "friction 0.05" in weaknesses(plain(slippery=0.4), LINKS, JOINTS, demand=demand)[0]


def test_a_good_grasp_has_no_weakness() -> None:
    assert weaknesses(plain(pushed=1e-6), LINKS, JOINTS) == [""]


def test_a_grasp_without_forces_says_so() -> None:
    nothing = np.array([np.nan])
    assert weaknesses(replace(plain(), slippery=nothing, pushed=nothing, open=nothing), LINKS, JOINTS) != [""]


def test_directions() -> None:
    assert direction_text(np.array([0.0, 0.0, 1.0])) == "+z"
    assert direction_text(np.array([-0.99, 0.1, 0.0])) == "-x"
    assert direction_text(np.array([0.6, 0.0, -0.8])) == "(0.6, 0.0, -0.8)"
