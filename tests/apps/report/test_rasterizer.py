"""Pictures show what is there: places, sizes, what hides what, and shadows."""

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
import trimesh

from grasp_refine.geometry import z_buffer
from grasp_refine_apps.report import rasterizer
from grasp_refine_apps.report.rasterizer import Camera, Model, count_owners, render

EYE, TARGET = np.array([1.0, 0.0, 0.0]), np.zeros(3)
UP = np.array([0.0, 0.0, 1.0])


def ball(radius: float, center: tuple[float, float, float], color: tuple[float, float, float]) -> Model:
    mesh = trimesh.creation.icosphere(subdivisions=4, radius=radius)
    normals = np.asarray(mesh.vertices) / radius
    return Model(np.asarray(mesh.vertices) + center, normals, np.asarray(mesh.faces), color)


def test_the_target_is_in_the_middle_up_is_up_and_depth_grows_away_from_the_camera():
    camera = Camera(EYE, TARGET, 100, 80, 0.2)
    np.testing.assert_allclose(camera.project(TARGET), [50, 40, 0])
    np.testing.assert_allclose(camera.project(np.array([-0.3, 0.05, 0.05])), [70, 20, 0.3])


def test_a_ball_covers_as_many_pixels_as_its_outline():
    camera = Camera(EYE, TARGET, 200, 200, 0.2)
    image = render([ball(0.05, (0, 0, 0), (1, 1, 1))], camera, UP)
    assert image[..., 3].sum() == pytest.approx(np.pi * 50**2, rel=0.01)
    assert (image[image[..., 3] == 0] == 0).all()


def test_the_nearer_of_two_balls_is_seen_in_any_order():
    camera = Camera(EYE, TARGET, 100, 100, 0.2)
    red, blue = ball(0.03, (0, 0, 0), (1, 0, 0)), ball(0.03, (-0.1, 0, 0), (0, 0, 1))
    for models in ([red, blue], [blue, red]):
        r, _, b, _ = render(models, camera, EYE)[50, 50]
        assert r > 0.5 > 0.2 > b


def test_what_lies_below_another_is_in_its_shadow():
    camera = Camera(np.array([1.0, 0.0, 0.6]), TARGET, 100, 100, 0.3)
    low, high = ball(0.03, (0, 0, 0), (1, 1, 1)), ball(0.04, (0, 0, 0.12), (1, 1, 1))
    x, y, _ = camera.project(np.array([0.012, 0, 0.027])).round().astype(int)
    alone, shaded = (render(models, camera, UP)[y, x, 0] for models in ([low], [low, high]))
    assert shaded < 0.75 * alone


def test_surfaces_are_lit_from_either_side():
    """A face that is wound the wrong way round is as bright as a right one."""
    camera = Camera(EYE, TARGET, 50, 50, 0.2)
    model = ball(0.05, (0, 0, 0), (1, 1, 1))
    inverted = Model(model.vertices, -model.normals, model.faces[:, ::-1], model.color)
    np.testing.assert_allclose(render([inverted], camera, UP), render([model], camera, UP), atol=1e-9)


def soup(count: int, seed: int) -> np.ndarray:
    """Triangles (F, 3, 3) of many sizes that pass through each other, before, within and beside the picture."""
    rng = np.random.default_rng(seed)
    size = 10 ** rng.uniform(-2.5, -1.3, (count, 1, 1))
    return rng.uniform(-0.12, 0.12, (count, 1, 3)) + size * rng.normal(size=(count, 3, 3))


def vertices_and_faces(triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return triangles.reshape(-1, 3), np.arange(3 * len(triangles)).reshape(-1, 3)


def flat(triangles: np.ndarray) -> Model:
    """Triangles in a plane x = constant, which face the camera at `EYE`."""
    vertices, faces = vertices_and_faces(triangles)
    return Model(vertices, np.tile([1.0, 0.0, 0.0], (len(vertices), 1)), faces, (1, 1, 1))


def test_every_pixel_shows_the_triangle_that_its_ray_meets_first():
    camera = Camera(EYE, TARGET, 40, 30, 0.2)
    triangles = soup(200, 0)
    nearest, depth = rasterizer._rasterize(*vertices_and_faces(triangles), camera)

    y, x = (grid.ravel() for grid in np.mgrid[:30, :40] + 0.5)
    start, stop = (camera.lift(np.stack([x, y, np.full(1200, d)], axis=1))[:, None] for d in (-0.5, 0.5))
    a, b, c = triangles.transpose(1, 0, 2)
    # start + t (stop - start) = a + u (b - a) + v (c - a)
    sides = np.broadcast_arrays(start - stop, (b - a)[None], (c - a)[None])
    t, u, v = np.moveaxis(np.linalg.solve(np.stack(sides, axis=-1), (start - a)[..., None])[..., 0], -1, 0)
    met = np.where((u >= 0) & (v >= 0) & (u + v <= 1), t - 0.5, np.inf)
    expected = np.where(np.isfinite(met.min(axis=1)), met.argmin(axis=1), -1)
    assert 0.3 < (expected >= 0).mean() < 1 and len(np.unique(expected)) > 40
    np.testing.assert_array_equal(nearest.ravel(), expected)
    np.testing.assert_allclose(depth.ravel(), met.min(axis=1), atol=1e-9)


def test_triangles_that_share_an_edge_leave_no_gap_even_where_it_meets_centres_of_pixels():
    camera = Camera(EYE, TARGET, 20, 20, 0.2)
    for offset in (0.0, 0.005, 0.0031):
        y, z = np.meshgrid(np.arange(-12, 12) * 0.01 + offset, np.arange(-12, 12) * 0.01 + offset)
        corner = np.stack([np.zeros_like(y), y, z], axis=-1)
        a, b, c, d = corner[:-1, :-1], corner[:-1, 1:], corner[1:, 1:], corner[1:, :-1]
        triangles = np.stack([np.stack([a, b, c], -2), np.stack([a, c, d], -2)]).reshape(-1, 3, 3)
        assert render([flat(triangles)], camera, EYE)[..., 3].all()


def test_the_size_of_the_blocks_changes_nothing_but_the_memory(monkeypatch: pytest.MonkeyPatch):
    """300 triangles that fill a picture of 10,000 pixels would take 24 MB an array at once."""
    camera = Camera(EYE, TARGET, 100, 100, 0.2)
    triangles = np.random.default_rng(0).normal(size=(300, 3, 3)) * [0.05, 0.4, 0.4]
    images = []
    for block in (z_buffer.BLOCK_PIXELS, 100):
        monkeypatch.setattr(z_buffer, "BLOCK_PIXELS", block)
        tracemalloc.start()
        images.append(rasterizer._rasterize(*vertices_and_faces(triangles), camera))
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert peak < 20e6
    for first, second in zip(*images, strict=True):
        np.testing.assert_array_equal(first, second)


def test_what_leaves_the_picture_has_no_outline_at_its_border():
    """The pixels at one border were compared with those at the other, as if the picture were a ring."""
    camera = Camera(EYE, TARGET, 30, 20, 0.2)
    corners = np.array([[0.2, -1, -1], [0.2, 1, -1], [-0.2, 1, 1], [-0.2, -1, 1]])
    tilted = Model(corners, np.tile([0.98, 0, 0.199], (4, 1)), np.array([[0, 1, 2], [0, 2, 3]]), (1, 1, 1))
    # Lit from behind, it has the same colour everywhere.
    image = render([tilted], camera, -EYE)
    assert image[..., 0].min() == pytest.approx(image[..., 0].max(), rel=1e-9)


def test_a_step_between_two_models_is_drawn_on_the_nearer_one():
    camera = Camera(EYE, TARGET, 40, 40, 0.2)
    back = np.array([[[0.0, -1, -1], [0, 1, -1], [0, 1, 1]], [[0, -1, -1], [0, 1, 1], [0, -1, 1]]])
    for step, seen in ((0.001, True), (0.0001, False)):
        front = 0.05 * back + [step, 0, 0]
        brightness = render([flat(back), flat(front)], camera, -EYE)[..., 0]
        dark = brightness < 0.6 * brightness[0, 0]
        expected = np.zeros((40, 40), dtype=bool)
        expected[10:30, 10:30] = seen
        expected[11:29, 11:29] = False
        np.testing.assert_array_equal(dark, expected)


def test_what_is_behind_a_translucent_model_shows_through():
    camera = Camera(EYE, TARGET, 100, 100, 0.2)
    red, glass = ball(0.02, (-0.1, 0, 0), (1, 0, 0)), replace(ball(0.05, (0, 0, 0), (0, 0, 1)), opacity=0.75)
    for models in ([red, glass], [glass, red]):
        image = render(models, camera, UP)
        alone, behind = (render([model], camera, UP) for model in (replace(glass, opacity=1.0), red))
        # Away from the smaller one's border and shadow there is no more to it than a mean.
        np.testing.assert_allclose(image[45, 50, 2], 0.75 * alone[45, 50, 2] + 0.25 * behind[45, 50, 2], atol=0.04)
        assert image[45, 50, 0] > 0.1 and image[45, 50, 3] == pytest.approx(1.0)
        assert image[50, 72, 3] == pytest.approx(0.75), "nothing is behind it there"
    in_front = render([glass, replace(red, vertices=red.vertices + [0.2, 0, 0])], camera, UP)
    assert in_front[50, 50, 2] < 0.1


def test_owners_are_counted_where_they_are_nearest():
    camera = Camera(EYE, TARGET, 200, 200, 0.2)
    counts = count_owners([ball(0.05, (0, 0, 0), (1, 1, 1)), ball(0.02, (0.06, 0, 0), (1, 1, 1))], camera)
    np.testing.assert_allclose(counts, [np.pi * (50**2 - 20**2), np.pi * 20**2], rtol=0.02)


def test_a_fitted_camera_shows_all_points_and_no_more():
    points = np.random.default_rng(3).normal(size=(50, 3)) * [0.1, 0.02, 0.05] + [1.0, 2.0, 3.0]
    for direction in ([1.0, 0.0, 0.0], [0.2, -0.7, 0.4], [0.0, 0.6, -0.8]):
        x, y, depth = Camera.fitted(np.array(direction), points, 600, 400, margin=0.25).project(points).T
        assert max(np.abs(x - 300).max() / 300, np.abs(y - 200).max() / 200) == pytest.approx(0.8)
        assert depth.min() == pytest.approx(-depth.max())
