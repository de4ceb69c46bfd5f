"""The fit of the calibration, on grasps that hold by a known law."""

import numpy as np
import pytest

from grasp_refine.forces.calibration import Calibration
from grasp_refine_apps.authoring.calibrate_quality import Samples, fit, left_out, main

LAW = Calibration(4.0, (5.0, 3.0, 0.0, 1.0, 4.0, 2.0))


def samples(source: np.ndarray, shortcomings: np.ndarray, held: np.ndarray) -> Samples:
    """Grasps of one task."""
    return Samples(source, np.full(len(held), "dexgraspbench"), shortcomings, held)


@pytest.fixture(scope="module")
def drawn() -> Samples:
    """30,000 grasps of four generators, which hold with the probability of the law; none has both excesses."""
    rng = np.random.default_rng(0)
    shortcomings = rng.uniform(0.0, 1.0, (30_000, 6)) ** 2
    for first, columns in enumerate(([-2, -1], [-2], [-1])):
        shortcomings[first::3, columns] = 0.0
    held = rng.uniform(size=len(shortcomings)) < LAW.probability(shortcomings)
    return samples(np.array(["a", "b", "c", "d"])[rng.integers(0, 4, len(held))], shortcomings, held)


def test_the_law_is_found(drawn: Samples) -> None:
    found = fit(drawn)
    assert found.offset == pytest.approx(LAW.offset, rel=0.1)
    np.testing.assert_allclose(found.weights, LAW.weights, atol=0.4)


def test_a_shortcoming_that_seems_to_help_gets_no_weight(drawn: Samples) -> None:
    """Deeper grasps held more often: by chance or not, depth must not raise the probability."""
    odd = samples(drawn.source, drawn.shortcomings, drawn.held | (drawn.shortcomings[:, 2] > 0.5))
    assert fit(odd).weights[2] == 0.0


@pytest.mark.parametrize("column", [-2, -1])
def test_weak_actuators_and_close_contacts_change_nothing_for_others(drawn: Samples, column: int) -> None:
    exceeding = drawn.shortcomings[:, column] > 0.0
    others, before = fit(samples(drawn.source, drawn.shortcomings, drawn.held & ~exceeding)), fit(drawn)
    assert others.offset == before.offset and np.delete(others.weights, column) == pytest.approx(
        np.delete(before.weights, column), abs=0.0
    )
    assert others.weights[column] > before.weights[column] + 10.0


def test_grasps_are_judged_by_the_others(drawn: Samples) -> None:
    """The verdicts of one generator are turned around: its own estimates stay, those of the others change."""
    at = drawn.source == "a"
    turned = samples(drawn.source, drawn.shortcomings, np.where(at, ~drawn.held, drawn.held))
    before, after = left_out(drawn), left_out(turned)
    np.testing.assert_array_equal(before[at], after[at])
    assert (np.abs(before[~at] - after[~at]) > 0.05).mean() > 0.5


def test_estimates_are_what_happens(drawn: Samples, tmp_path, capsys: pytest.CaptureFixture[str]) -> None:
    np.savez(tmp_path / "samples.npz", **vars(drawn))
    main([str(tmp_path), "--samples", str(tmp_path / "samples.npz")])
    rows = [line.split() for line in capsys.readouterr().out.splitlines() if line.startswith("  0.")]
    bins = np.array([[float(value) for value in (row[0], row[2].rstrip(":"), *row[3:])] for row in rows])
    assert len(bins) == 10 and bins[:, 4].sum() == len(drawn.held)
    assert (bins[:, 0] <= bins[:, 2]).all() and (bins[:, 2] <= bins[:, 1]).all()
    assert (np.abs(bins[:, 2] - bins[:, 3]) < 4.0 * np.sqrt(0.25 / bins[:, 4]) + 0.005).all()
