"""Scans from points: thinning, outliers, normals, noise; and refusals by name."""

import numpy as np
import pytest

from grasp_refine.core.errors import MeshError
from grasp_refine.scans.cleaning import MAX_POINTS, scan_of_points, thinned

SENSOR = np.array([[0.0, 0.0, 0.5]])
RADIUS_M = 0.05


def dome(count: int, seed: int = 0, noise_m: float = 0.0) -> np.ndarray:
    """Points (count, 3) on the upper half of a sphere."""
    random = np.random.default_rng(seed)
    way = random.standard_normal((count, 3))
    way[:, 2] = np.abs(way[:, 2])
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    return way * (RADIUS_M + noise_m * random.standard_normal(count))[:, None]


def scan_of(points: np.ndarray, **options):
    return scan_of_points(points, None, SENSOR, None, "thing", **options)


def test_normals_face_the_sensor_and_are_those_of_the_surface():
    scan, notes = scan_of(dome(4000))
    cosine = (scan.points / RADIUS_M * scan.normals).sum(axis=1)
    assert not notes
    assert np.median(cosine) > 0.999 and ((SENSOR - scan.points) * scan.normals).sum(axis=1).min() >= 0
    below = scan_of_points(dome(4000), None, -SENSOR, None, "thing")[0]
    assert np.median((below.points * below.normals).sum(axis=1)) < 0


def test_normals_are_kept_made_unit_and_turned_to_the_sensor():
    points = dome(1000)
    normals = 3 * points
    normals[::2] *= -1
    normals[0] = np.nan
    scan, _ = scan_of_points(points, normals, SENSOR, None, "thing")
    kept = ((SENSOR - points) * points).sum(axis=1) > 0
    kept[0] = False
    np.testing.assert_allclose(scan.normals[kept], points[kept] / RADIUS_M, atol=1e-9)
    assert scan.normals[0] @ points[0] > 0.9 * RADIUS_M
    # Without a sensor they stay as they are.
    free, _ = scan_of_points(points, points, np.zeros((0, 3)), None, "thing")
    np.testing.assert_allclose(free.normals, points / RADIUS_M)


def test_the_noise_is_measured():
    for noise in (0.0002, 0.001):
        assert scan_of(dome(8000, noise_m=noise))[0].noise_m == pytest.approx(noise, rel=0.25)
    assert scan_of(dome(8000, noise_m=0.001), noise_m=0.003)[0].noise_m == 0.003


def test_points_belong_to_the_nearest_sensor():
    points = np.concatenate([dome(500), dome(500) * [1, 1, -1]])
    scan, _ = scan_of_points(points, None, np.concatenate([SENSOR, -SENSOR]), None, "thing")
    np.testing.assert_array_equal(scan.view, (scan.points[:, 2] < 0).astype(int))


def test_points_that_are_not_finite_and_outliers_are_dropped_with_a_note():
    points = dome(3000)
    random = np.random.default_rng(1)
    bad = np.full((40, 3), np.nan)
    bad[1::2, :2] = 0.01
    stray = random.uniform(-0.1, 0.1, (30, 3))
    stray = stray[np.abs(np.linalg.norm(stray, axis=1) - RADIUS_M) > 0.01]
    scan, notes = scan_of(np.concatenate([bad, points, stray]))
    assert np.abs(np.linalg.norm(scan.points, axis=1) - RADIUS_M).max() < 1e-9
    assert len(scan.points) > 2950
    assert any("40 points" in note for note in notes) and any("outlier" in note for note in notes)


def test_large_clouds_are_thinned_evenly():
    points = dome(300_000, noise_m=0.0002)
    scan, notes = scan_of(points)
    assert MAX_POINTS / 2 < len(scan.points) <= MAX_POINTS and "300000" in "".join(notes)
    high = scan.points[:, 2] > RADIUS_M / 2
    # Equal heights of a sphere have equal areas.
    assert high.mean() == pytest.approx(0.5, abs=0.03)
    np.testing.assert_allclose(np.linalg.norm(scan.points, axis=1), RADIUS_M, atol=1e-3)


def test_thinning_keeps_views_apart():
    points = dome(5000)
    view = np.arange(5000) % 2
    fewer, normals, views = thinned(points, points, view, 1000)
    assert len(fewer) == len(views) == len(normals) <= 1000
    assert set(views) == {0, 1}
    # Of points that are all alike one stays for each view.
    assert len(thinned(np.zeros((5000, 3)), None, view, 1000)[0]) == 2


@pytest.mark.parametrize("angle", [0.0, 0.5, 1.2])
@pytest.mark.parametrize("noise", [0.0, 0.001])
def test_a_plane_is_refused(angle, noise):
    random = np.random.default_rng(0)
    flat = np.column_stack([random.uniform(-0.15, 0.15, (5000, 2)), noise * random.standard_normal(5000)])
    turn = np.array([[np.cos(angle), 0, -np.sin(angle)], [0, 1, 0], [np.sin(angle), 0, np.cos(angle)]])
    with pytest.raises(MeshError, match="plane"):
        scan_of(flat @ turn.T)
    scan, notes = scan_of(flat @ turn.T, masked=True)
    assert len(scan.points) and any("plane" in note for note in notes)


def test_a_table_below_the_object_is_noted_and_a_side_of_it_is_not():
    random = np.random.default_rng(0)
    table = np.column_stack([random.uniform(-0.2, 0.2, (6000, 2)), np.zeros(6000)])
    table = table[np.linalg.norm(table[:, :2], axis=1) > RADIUS_M] + 0.0005 * random.standard_normal((1, 3))
    _, notes = scan_of(np.concatenate([table, dome(1500)]))
    assert any("table" in note for note in notes)
    assert not scan_of(np.concatenate([table, dome(1500)]), masked=True)[1]
    # The top of a box, and what is seen of its sides.
    top = np.column_stack([random.uniform(-0.05, 0.05, (4000, 2)), np.zeros(4000)])
    side = np.column_stack([np.full(1000, 0.05), random.uniform(-0.05, 0.05, 1000), random.uniform(-0.04, 0, 1000)])
    assert not scan_of_points(np.concatenate([top, side]), None, np.array([[0.4, 0, 0.4]]), None, "box")[1]


def test_two_objects_are_refused_and_parts_of_one_are_not():
    with pytest.raises(MeshError, match="two objects"):
        scan_of(np.concatenate([dome(2000), dome(1000) + [0.3, 0, 0]]))
    # A gap of a centimetre: what lies before the object hides a strip of it.
    scan, _ = scan_of(np.concatenate([dome(2000), dome(1000) + [0.11, 0, 0]]))
    assert len(scan.points) > 2900


@pytest.mark.parametrize("count", [0, 1, 5])
def test_too_few_points_are_refused(count):
    with pytest.raises(MeshError, match="empty" if count == 0 else str(count)):
        scan_of(dome(100)[:count])


def test_points_without_normals_need_a_sensor():
    with pytest.raises(MeshError, match="sensor"):
        scan_of_points(dome(500), None, np.zeros((0, 3)), None, "thing")
