"""The probability of holding: its formula, and what may never raise it."""

import numpy as np

from grasp_refine.forces.calibration import CALIBRATION, Calibration
from grasp_refine.forces.quality import SHORTCOMINGS


def test_log_odds_fall_with_the_roots_of_the_shortcomings() -> None:
    model = Calibration(2.0, (3.0, 0.0, 1.0, 0.5))
    given = np.array([[0.0, 9.0, 0.0, 0.0], [0.25, 0.0, 0.0, 0.16], [4.0, 0.0, 1.0, 0.0]])
    odds = np.array([2.0, 2.0 - 1.5 - 0.2, 2.0 - 6.0 - 1.0])
    np.testing.assert_allclose(model.probability(given), 1.0 / (1.0 + np.exp(-odds)))
    np.testing.assert_allclose(model.costs(given).sum(axis=1), 2.0 - odds)


def test_no_shortcoming_raises_the_probability() -> None:
    rng = np.random.default_rng(0)
    given = rng.uniform(0.0, 1.0, (50, len(SHORTCOMINGS)))
    for column in range(len(SHORTCOMINGS)):
        more = given.copy()
        more[:, column] += 0.1
        assert (CALIBRATION.probability(more) <= CALIBRATION.probability(given)).all()


def test_what_is_not_known_has_no_probability() -> None:
    assert np.isnan(CALIBRATION.probability(np.full((1, len(SHORTCOMINGS)), np.nan)))[0]
