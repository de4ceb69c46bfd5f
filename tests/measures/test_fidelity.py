"""Fidelity of transfers: closed forms on a sphere, and the boundary of each word."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from grasp_refine.hands.hand import Hand, load_hand
from grasp_refine.measures.fidelity import OTHER_M, OTHER_RAD, SAME_M, Fidelity
from grasp_refine.measures.geometry import measure
from grasp_refine.objects.object import load_object
from grasp_refine.scene.hand_object import HandObject
from grasp_refine.scene.original import Original
from grasp_refine.scene.scene import Scene
from made_hands import joint, links, solid, write_urdf

RADIUS = 0.03


def original(points: list[list[float] | None], *, dropped: str = "", opposed: tuple[int, ...] = (0, 1)) -> Original:
    """One grasp whose fingers touched at points."""
    point = np.array([[[np.nan] * 3 if one is None else one for one in points]])
    names = np.array([["" if one is None else f"f{k}" for k, one in enumerate(points)]])
    mask = np.isin(np.arange(len(points)), opposed)[None]
    up = np.array([[0.0, 0.0, 1.0]])
    return Original(point, point / RADIUS, names, np.array([dropped]), mask, up, up)


@pytest.fixture
def jaws(tmp_path: Path) -> Hand:
    """Two balls of 1 cm that close along x."""
    ball = solid("sphere 0.01")
    body = links("palm", "a", "b", inside=ball)
    body += joint("l", "palm", "a", "prismatic", at="-0.05 0 0.1", axis="1 0 0", limits=(0, 0.04))
    body += joint("r", "palm", "b", "prismatic", at="0.05 0 0.1", axis="-1 0 0", limits=(0, 0.04))
    return load_hand(write_urdf(tmp_path, body), candidates=64)


def measured(hand: Hand, of: Original) -> Fidelity:
    """The jaws on a sphere, which they touch at its sides."""
    ball = load_object(f"sphere:{RADIUS}")
    T, q = np.eye(4)[None].copy(), np.full((1, 2), 0.05 - RADIUS - 0.01)
    T[0, 2, 3] = -0.1
    scene = Scene(hand, ball, T, q)
    none = np.full((1, len(scene.links), 3), np.nan)
    return Fidelity.of(hand, scene.links, of, measure(HandObject.of(scene), T, q, none, none).witness, T)


@pytest.mark.parametrize("degrees", [0.0, 10.0, 25.0])
def test_distances_on_a_sphere_are_chords(jaws: Hand, degrees: float):
    angle = np.radians(degrees)
    away = [-RADIUS * np.cos(angle), RADIUS * np.sin(angle), 0.0]
    found = measured(jaws, original([away, [RADIUS, 0.0, 0.0]]))
    chord = 2.0 * RADIUS * np.sin(0.5 * angle)
    np.testing.assert_allclose(found.distance, [[chord, 0.0]], atol=1e-5)
    np.testing.assert_allclose(found.original_shift, 0.5 * chord, atol=1e-5)
    np.testing.assert_allclose(found.original_shift_most, chord, atol=1e-5)
    np.testing.assert_allclose(found.original_kept, 1.0)
    assert found.likeness.tolist() == ["same grasp"]


def test_a_finger_that_does_not_touch_is_not_kept(jaws: Hand):
    of = original([[-RADIUS, 0, 0], [RADIUS, 0, 0]])
    ball = load_object(f"sphere:{RADIUS}")
    T, q = np.eye(4)[None].copy(), np.array([[0.01, 0.005]])
    T[0, 2, 3] = -0.1
    scene = Scene(jaws, ball, T, q)
    none = np.full((1, len(scene.links), 3), np.nan)
    found = Fidelity.of(jaws, scene.links, of, measure(HandObject.of(scene), T, q, none, none).witness, T)
    np.testing.assert_allclose(found.original_kept, 0.5)
    assert found.likeness.tolist() == ["another grasp"]
    assert found.texts(jaws.fingers).tolist() == ["f0 by a: kept; f1 by b: does not touch"]


@pytest.mark.parametrize(
    ("distance", "dropped", "turn", "word"),
    [
        ([0.0, SAME_M, 0.9], "", 0.0, "same grasp"),
        ([0.0, SAME_M + 1e-9, 0.0], "", 0.0, "contacts moved"),
        ([0.0, 0.0, 0.0], "little", 0.0, "fingers dropped"),
        ([0.0, 0.0, np.nan], "", 0.0, "fingers dropped"),
        ([0.0, OTHER_M + 1e-9, 0.0], "", 0.0, "another grasp"),
        ([0.0, np.nan, 0.0], "", 0.0, "another grasp"),
        ([0.0, 0.0, 0.0], "", OTHER_RAD + 1e-9, "another grasp"),
        ([np.nan, np.nan, np.nan], "", 0.0, "another grasp"),
    ],
)
def test_words_have_boundaries(distance: list[float], dropped: str, turn: float, word: str):
    of = original([[RADIUS, 0, 0]] * 3, dropped=dropped)
    assert Fidelity(np.array([distance]), of, np.array([turn])).likeness.tolist() == [word]


@pytest.mark.parametrize(
    ("farthest", "word"),
    [(SAME_M, "same grasp"), (SAME_M + 1e-9, "contacts moved"), (OTHER_M + 1e-9, "another grasp")],
)
def test_without_a_thumb_in_contact_all_fingers_count(farthest: float, word: str):
    of = original([None, [RADIUS, 0, 0], [RADIUS, 0, 0]], opposed=())
    found = Fidelity(np.array([[np.nan, 0.0, farthest]]), of, np.zeros(1))
    assert np.isnan(found.original_pinch_shift).all() and found.likeness.tolist() == [word]
