"""Directions of jaws in the frame of the base link."""

from pathlib import Path

import numpy as np
import pytest

from grasp_refine.hands.jaws import jaws_of
from made_hands import link, made_hand, slide, solid

PLATE = solid("box 0.06 0.01 0.03", "0.05 0 0")


def test_jaws_open_along_y_and_reach_along_x(tmp_path: Path) -> None:
    """Their frame has x along the opening and z along the reach; both joints open towards their lower limit."""
    hand = made_hand(
        tmp_path,
        link("palm", solid("box 0.02 0.2 0.03")),
        link("left", PLATE),
        link("right", PLATE),
        slide("l", "palm", "left", at="0 0.09 0", axis="0 -1 0", limits=(0, 0.07)),
        slide("r", "palm", "right", at="0 -0.09 0", axis="0 1 0", limits=(0, 0.06)),
    )
    jaws = jaws_of(hand)
    assert jaws is not None
    assert np.abs(jaws.axis).tolist() == [0, 1, 0] and jaws.approach.tolist() == [1, 0, 0]
    assert jaws.opened.tolist() == [0, 0] and jaws.closed == pytest.approx([0.07, 0.06])
    R = jaws.T_jaws_base[:3, :3]
    np.testing.assert_allclose(R @ jaws.axis, [1, 0, 0], atol=1e-12)
    np.testing.assert_allclose(R @ jaws.approach, [0, 0, 1], atol=1e-12)
    assert np.linalg.det(R) == pytest.approx(1)
