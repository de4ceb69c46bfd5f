"""Colours say on which side of the surface a point is, on any background and to anybody."""

from itertools import combinations

import numpy as np
import pytest

from grasp_refine_apps.viewer.drawing.colors import COLOR_STOPS_MM, UNKNOWN_COLOR, distance_colors, tinted

DISTANCES = 1e-3 * np.array([-8.0, -5.0, -2.0, -1.0, -0.5, -0.3, 0.0, 0.3, 0.5, 1.0, 3.0, 6.0, 10.0, 50.0])

SEEN = {
    "all": np.eye(3),
    "no red": np.array(
        [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]]
    ),
    "no green": np.array(
        [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]]
    ),
    "no blue": np.array(
        [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]]
    ),
}
"""What people see who lack one kind of cone, linear RGB (Machado, Oliveira and Fernandes 2009, severity 1)."""


def linear(colors: np.ndarray) -> np.ndarray:
    """Linear RGB in [0, 1] of sRGB colours in 0 to 255."""
    srgb = np.asarray(colors) / 255
    return np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)


def lab(rgb: np.ndarray) -> np.ndarray:
    """CIE L*a*b* of linear RGB, white D65."""
    xyz = np.clip(rgb, 0, 1) @ np.array(
        [[0.4124564, 0.2126729, 0.0193339], [0.3575761, 0.7151522, 0.1191920], [0.1804375, 0.0721750, 0.9503041]]
    )
    t = xyz / [0.95047, 1.0, 1.08883]
    f = np.where(t > (6 / 29) ** 3, np.cbrt(t), t / (3 * (6 / 29) ** 2) + 4 / 29)
    return np.stack([116 * f[..., 1] - 16, 500 * (f[..., 0] - f[..., 1]), 200 * (f[..., 1] - f[..., 2])], axis=-1)


def test_between_stops_colours_are_mixed_and_beyond_they_stay():
    at = distance_colors(1e-3 * np.array([millimetres for millimetres, _ in COLOR_STOPS_MM]))
    np.testing.assert_array_equal(at, [color for _, color in COLOR_STOPS_MM])
    assert tinted((0, 100, 250), (250, 100, 0)) == (150, 100, 100)
    middle, deep, far = distance_colors(1e-3 * np.array([-3.0, -30.0, 500.0]))
    np.testing.assert_allclose(middle, np.mean([COLOR_STOPS_MM[0][1], COLOR_STOPS_MM[1][1]], axis=0), atol=0.5)
    assert tuple(deep) == COLOR_STOPS_MM[0][1] and tuple(far) == COLOR_STOPS_MM[-1][1]


def test_inside_is_warm_touching_green_and_outside_cool():
    red, green, blue = distance_colors(DISTANCES).astype(int).T
    assert (red[DISTANCES < -2e-4] > np.maximum(green, blue)[DISTANCES < -2e-4]).all()
    assert (green > np.maximum(red, blue))[DISTANCES == 0].all()
    assert (blue > np.maximum(red, green))[DISTANCES > 2e-4].all()


def test_what_is_not_known_is_grey():
    assert tuple(distance_colors(np.array([np.nan]))[0]) == UNKNOWN_COLOR
    assert distance_colors(np.zeros(0)).shape == (0, 3)


@pytest.mark.parametrize("background", [(255, 255, 255), (246, 247, 249), (24, 25, 28), (0, 0, 0)])
def test_colours_show_on_white_and_on_black(background: tuple[int, int, int]):
    """Contrast of luminance as WCAG counts it: at least 2 to 1."""
    luminance = linear(np.array([*distance_colors(DISTANCES), background])) @ [0.2126, 0.7152, 0.0722]
    high, low = np.maximum(luminance[:-1], luminance[-1]), np.minimum(luminance[:-1], luminance[-1])
    assert ((high + 0.05) / (low + 0.05)).min() > 2.0


@pytest.mark.parametrize("missing", SEEN)
def test_people_who_see_fewer_colours_distinguish_the_sides(missing: str):
    """Inside by 1 mm, touching, and off by 1 mm differ by ten times what can just be seen."""
    seen = lab(linear(distance_colors(np.array([-1e-3, 0.0, 1e-3]))) @ SEEN[missing].T)
    assert all(np.linalg.norm(one - other) > 23 for one, other in combinations(seen, 2))
