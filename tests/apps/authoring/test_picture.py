"""The README's picture: its file, and that the script still draws it."""

from __future__ import annotations

import numpy as np
import pytest

from grasp_refine_apps.authoring import picture


def reds_and_greens(half: np.ndarray) -> tuple[int, int]:
    """How many pixels of a picture are in the two colours of marks."""
    r, g, b = half.astype(int).transpose(2, 0, 1)
    return int(((r > 150) & (g < 80) & (b < 80)).sum()), int(((g > 110) & (r < 90) & (b < 110)).sum())


def test_the_script_draws_bad_contacts_left_and_good_ones_right(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(picture, "WIDTH", 350)
    monkeypatch.setattr(picture, "HEIGHT", 300)
    monkeypatch.setattr(picture, "OVERSAMPLING", 1)
    drawn = picture.draw_example()
    assert drawn.shape == (300, 700, 3) and drawn.dtype == np.uint8
    (red_left, green_left), (red_right, green_right) = map(reds_and_greens, (drawn[:, :350], drawn[:, 350:]))
    assert red_left > 100 > green_left
    assert green_right > 100 > red_right
