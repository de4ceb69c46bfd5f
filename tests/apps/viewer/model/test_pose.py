"""Targets of grasps as grasp files have them."""

import numpy as np

from grasp_refine_apps.viewer.model.pose import Target, file_targets, file_targets_of


def test_the_kth_target_of_a_link_has_a_column_of_its_own() -> None:
    points = np.random.default_rng(0).normal(size=(5, 2, 3))
    named = [Target(link, *point) for link, point in zip(("a", "b", "a", "b", "a"), points, strict=True)]
    found = file_targets_of([named[:3], [], named[3:]])
    assert found is not None and found.links == ("a", "b", "a")
    nothing = np.full(3, np.nan)
    rows = [[points[0], points[1], points[2]], [nothing] * 3, [points[4], points[3], nothing]]
    for array, end in ((found.point_link, 0), (found.point_object, 1)):
        expected = [[one if one is nothing else one[end] for one in row] for row in rows]
        np.testing.assert_array_equal(array, expected)
    assert file_targets(()) is None and file_targets_of([[], []]) is None
