"""Rows of least squares: scaled by the roots of their weights, none lost, empty ones left out."""

import numpy as np

from grasp_refine.solvers.rows import Rows


def grams(rows: Rows) -> tuple[np.ndarray, np.ndarray]:
    """Sums of the squares (M,), and of covector times residual (M, 6), over all rows."""
    residual, covector, _, _ = rows.stacked()
    return (residual**2).sum(axis=1), np.einsum("mr,mrk->mk", residual, covector)


def test_weights_multiply_squares_and_their_gradients() -> None:
    rng = np.random.default_rng(0)
    r, c = rng.normal(size=(3, 2, 4)), rng.normal(size=(3, 2, 4, 6))
    rows = Rows(3)
    rows.add(r, c, 9.0, np.array([5, 7]))
    squares, gradient = grams(rows)
    np.testing.assert_allclose(squares, 9.0 * (r**2).sum(axis=(1, 2)))
    np.testing.assert_allclose(gradient, 9.0 * np.einsum("mck,mckj->mj", r, c))
    _, _, link, minus = rows.stacked()
    np.testing.assert_array_equal(link, np.tile([5] * 4 + [7] * 4, (3, 1)))
    assert minus is None


def test_one_sided_residuals_keep_what_is_active_and_no_more_rows_than_the_most_active_grasp() -> None:
    rng = np.random.default_rng(1)
    r = np.maximum(rng.normal(size=(4, 9)) - 0.8, 0.0)
    r[2] = 0.0
    c = rng.normal(size=(4, 9, 6))
    first, second = np.arange(9) + 10, np.arange(9) + 20
    rows = Rows(4)
    rows.add_active(r, c, 4.0, first, second)
    residual, covector, link, minus = rows.stacked()
    most = (r > 0).sum(axis=1).max()
    assert residual.shape == (4, most) and covector.shape == (4, most, 6) and 0 < most < 9
    squares, gradient = grams(rows)
    np.testing.assert_allclose(squares, 4.0 * (r**2).sum(axis=1))
    np.testing.assert_allclose(gradient, 4.0 * np.einsum("mp,mpk->mk", r, c))
    # Each row stands for its own pair; rows that only fill up act on nothing.
    for m in range(4):
        for row in range(most):
            pair = link[m, row] - 10
            assert minus[m, row] == pair + 20 and residual[m, row] == 2.0 * r[m, pair]
            np.testing.assert_array_equal(covector[m, row], 2.0 * c[m, pair] if r[m, pair] > 0 else 0.0)


def test_terms_follow_each_other_and_links_without_a_partner_say_so() -> None:
    rows = Rows(2)
    rows.add(np.ones((2, 1, 1)), np.ones((2, 1, 1, 6)), 1.0, np.array([3]))
    rows.add_active(np.array([[0.0, 2.0], [0.0, 0.0]]), np.ones((2, 2, 6)), 1.0)
    assert rows.stacked()[3] is None
    rows.add_active(np.array([[1.0], [1.0]]), np.ones((2, 1, 6)), 1.0, np.array([4]), np.array([6]))
    residual, _, link, minus = rows.stacked()
    np.testing.assert_array_equal(residual, [[1.0, 2.0, 1.0], [1.0, 0.0, 1.0]])
    np.testing.assert_array_equal(link[0], [3, 1, 4])
    np.testing.assert_array_equal(minus[0], [-1, -1, 6])


def test_nothing_active_adds_nothing() -> None:
    rows = Rows(3)
    rows.add_active(np.zeros((3, 5)), np.ones((3, 5, 6)), 100.0)
    residual, covector, link, minus = rows.stacked()
    assert residual.shape == (3, 0) and covector.shape == (3, 0, 6) and link.shape == (3, 0) and minus is None
    assert Rows(0).stacked()[0].shape == (0, 0)
