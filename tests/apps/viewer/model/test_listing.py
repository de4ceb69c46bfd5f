"""Lists of grasps: sorted, filtered, and walked through."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from grasp_refine.problem.load import load_problem
from grasp_refine.problem.spec import ProblemSpec
from grasp_refine.results.certificate import record_verdicts
from grasp_refine.scene.protocols.dexgraspbench import DEXGRASPBENCH
from grasp_refine.scene.task import Task
from grasp_refine.validation.trials import Reason
from grasp_refine_apps.viewer.model.collection import Collection
from grasp_refine_apps.viewer.model.listing import (
    MARK,
    NO_MARK,
    NUMBER,
    Listing,
    first_descending,
    random_other,
    step,
    worst,
)
from made_results import made_trials, save_example_results
from open_viewer import made_trial


@pytest.fixture(scope="module")
def collection(tmp_path_factory: pytest.TempPathFactory) -> Collection:
    """Eight grasps of quality 0, 7, 6, 5, 4, 3, 2, 1 eighths; 1 and 2 of 0 to 3 held; 2 is marked good, 5 bad."""
    path = save_example_results(tmp_path_factory.mktemp("listing") / "results.npz", 8)
    found = Collection.of(load_problem(ProblemSpec(grasps=path)))
    held = {number: Reason.HELD if number in (1, 2) else Reason.MOVED for number in range(4)}
    found = found.with_trials({number: made_trial(reason) for number, reason in held.items()})
    return found.with_mark(2, "good").with_mark(5, "bad")


def test_verdicts_of_engines_in_the_file_are_listed(tmp_path: Path) -> None:
    path = save_example_results(tmp_path / "results.npz", 3)
    held = made_trials(np.array([[Reason.HELD], [Reason.MOVED]]))
    record_verdicts(path, np.array([0, 2]), {"drake": held}, DEXGRASPBENCH, Task(), {})
    collection = Collection.of(load_problem(ProblemSpec(grasps=path)))
    assert collection.columns["held_drake_after"].values.tolist() == ["held", "", "failed"]
    for wanted, numbers in (("held in Drake", [0]), ("failed in Drake", [2]), ("held in MuJoCo", []), ("held", [])):
        assert Listing(held=wanted).numbers(collection).tolist() == numbers, wanted


@pytest.mark.parametrize(
    ("listing", "numbers"),
    [
        (Listing(), [0, 1, 2, 3, 4, 5, 6, 7]),
        (Listing(descending=True), [7, 6, 5, 4, 3, 2, 1, 0]),
        (Listing("quality_after", descending=True), [1, 2, 3, 4, 5, 6, 7, 0]),
        (Listing("quality_after"), [0, 7, 6, 5, 4, 3, 2, 1]),
        (Listing("status"), [3, 7, 0, 1, 4, 5, 2, 6]),
        (Listing("held"), [0, 3, 1, 2, 4, 5, 6, 7]),
        (Listing("held", descending=True), [1, 2, 0, 3, 4, 5, 6, 7]),
        (Listing(MARK), [5, 2, 0, 1, 3, 4, 6, 7]),
        (Listing("no such column", descending=True), [0, 1, 2, 3, 4, 5, 6, 7]),
        (Listing(held="held"), [1, 2]),
        (Listing(status="converged", held="failed"), [0]),
        (Listing(change="kept"), [0, 3, 6]),
        (Listing("change", descending=True, status="converged"), [5, 0, 1, 4]),
        (Listing(mark="bad"), [5]),
        (Listing("quality_after", mark=NO_MARK), [0, 7, 6, 4, 3, 1]),
        (Listing(object="mug"), [0, 1, 2, 3, 4, 5, 6, 7]),
        (Listing(object="cup"), []),
        # Both ends of a range are in it; an unknown measure filters nothing.
        (Listing(ranges=(("quality_after", 0.25, 0.5), ("no such column", 0.0, 1.0))), [4, 5, 6]),
        (
            Listing("quality_after")
            .with_range("quality_after", (0.5, 1.0))
            .with_range("penetration_m_after", (0, 3e-4)),
            [2, 1],
        ),
    ],
)
def test_sorting_and_filters_work_together(collection: Collection, listing: Listing, numbers: list[int]) -> None:
    assert listing.numbers(collection).tolist() == numbers


def test_filters_of_what_nobody_knows_find_nothing(collection: Collection) -> None:
    unknown = replace(collection, columns={})
    assert not len(Listing(held="held").numbers(unknown))
    assert not len(Listing(status="converged").numbers(unknown)) and not len(Listing(change="kept").numbers(unknown))


def test_a_column_is_sorted_best_first_at_first(collection: Collection) -> None:
    keys = ("quality_after", "contact_error_m_after", "status", NUMBER, "no such column")
    assert [first_descending(collection, key) for key in keys] == [True, False, False, False, False]


def test_steps_follow_the_list_and_its_ends_are_joined() -> None:
    numbers = np.array([4, 1, 7])
    assert [step(numbers, number, 1) for number in (4, 1, 7)] == [1, 7, 4]
    assert [step(numbers, number, -1) for number in (4, 1, 7)] == [7, 4, 1]
    assert step(numbers, 0, 1) == 4
    assert step(numbers, 0, -1) == 7
    assert step(numbers[:0], 0, 1) is None


def test_a_random_grasp_is_another_one_of_the_list() -> None:
    numbers, random = np.array([4, 1, 7]), np.random.default_rng(0)
    assert {random_other(numbers, 4, random) for _ in range(50)} == {1, 7}
    assert [random_other(numbers, 4, np.random.default_rng(3)) for _ in range(2)] in ([1, 1], [7, 7])
    assert random_other(numbers[:1], 4, random) == 4
    assert random_other(numbers[:0], 4, random) is None


def test_the_worst_is_worst_by_quality_else_by_penetration(collection: Collection) -> None:
    assert worst(collection) == 0
    assert worst(collection, np.array([3, 7, 1])) == 7
    # Penetration grows with the number.
    assert worst(collection, key="penetration_m_after") == 7
    assert worst(replace(collection, columns={"penetration_m_after": collection.columns["penetration_m_after"]})) == 7
    assert worst(collection, key="status") is None
    assert worst(replace(collection, columns={})) is None
    assert worst(collection, np.zeros(0, dtype=int)) is None
    # An unknown grasp is never the worst.
    quality = collection.columns["quality_after"]
    values = np.where(np.arange(8) == 0, np.nan, quality.values)
    assert worst(collection.with_columns(quality.with_values(values))) == 7
