"""Pictures show what is there: places, sizes, what hides what, and shadows."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from apps.rasterizer import Camera, Model, render

EYE, TARGET = np.array([1.0, 0.0, 0.0]), np.zeros(3)
UP = np.array([0.0, 0.0, 1.0])


def ball(radius: float, center: tuple[float, float, float], color: tuple[float, float, float]) -> Model:
    mesh = trimesh.creation.icosphere(subdivisions=4, radius=radius)
    normals = np.asarray(mesh.vertices) / radius
    return Model(np.asarray(mesh.vertices) + center, normals, np.asarray(mesh.faces), color)


@pytest.mark.parametrize("perspective", [True, False])
def test_projecting_and_unprojecting_are_inverse(perspective: bool):
    camera = Camera(np.array([0.5, -0.3, 0.4]), np.array([0.0, 0.1, 0.0]), 40, 30, 0.2, perspective)
    depth = np.random.default_rng(0).uniform(0.3, 0.9, (30, 40))
    back = camera.project(camera.unproject(depth))
    y, x = np.mgrid[:30, :40] + 0.5
    np.testing.assert_allclose(back, np.stack([x, y, depth], axis=-1), atol=1e-9)


def test_the_target_is_in_the_middle_and_up_is_up():
    camera = Camera(EYE, TARGET, 100, 80, 0.2)
    np.testing.assert_allclose(camera.project(TARGET), [50, 40, 1])
    x, y, _ = camera.project(np.array([0.0, 0.05, 0.05]))
    assert x == pytest.approx(70) and y == pytest.approx(20)


def test_a_ball_covers_as_many_pixels_as_its_outline():
    camera = Camera(EYE, TARGET, 200, 200, 0.2, perspective=False)
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
