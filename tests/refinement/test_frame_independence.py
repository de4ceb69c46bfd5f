"""Refinement in another frame of the object: the scene is rotated and shifted, and the hands do the same with it."""

from dataclasses import replace

import numpy as np
import pytest

from boxed_example import boxed_example
from compiled import needs_compiled
from grasp_refine.core.se3 import exp_se3, inverse, transform_points
from grasp_refine.geometry.body import Body
from grasp_refine.geometry.sampling import Candidates
from grasp_refine.refinement import force_closure_search
from grasp_refine.refinement.config import Config
from grasp_refine.refinement.refine import refine
from grasp_refine.scene.scene import Scene

T_NEW_OLD = exp_se3(np.array([0.3, -0.2, 0.1, 0.4, -1.1, 0.7]))


def moved(scene: Scene) -> Scene:
    """The scene in another frame: pieces, surface points, mesh and hands."""
    T, old = T_NEW_OLD, scene.object
    R = T[:3, :3]
    points = old.body.candidates
    samples = Candidates(transform_points(T, points.points), points.normals @ R.T, points.areas)
    body = Body(old.body.name, tuple(piece.transformed(T) for piece in old.body.pieces), samples)
    obj = replace(old, mesh=old.mesh.copy().apply_transform(T)).with_body(body)
    return replace(scene, object=obj, T_world_root=T @ scene.T_world_root)


@pytest.fixture(scope="module")
def scene() -> Scene:
    """The example grasps, moved to the side by 1 cm: some of them need further starts."""
    scene = boxed_example()
    T = scene.T_world_root.copy()
    T[:, :3, 3] += 0.012 * np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [0, -1, 1]])
    return replace(scene, T_world_root=T).select(np.array([0, 2]))


@needs_compiled
def test_hands_refined_in_another_frame_are_the_same_hands(scene: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    """Loads, pyramids and the noise of starts once followed the object's axes: hands differed by millimetres."""
    monkeypatch.setattr(force_closure_search, "GOOD_SCORE", 0.0)
    here, there = (refine(one, Config(starts=2, prefer="strongest")) for one in (scene, moved(scene)))
    assert (here.starts == 2).all()
    for name in ("status", "starts", "touching"):
        np.testing.assert_array_equal(getattr(there, name), getattr(here, name), err_msg=name)
    np.testing.assert_allclose(inverse(T_NEW_OLD) @ there.T_world_root, here.T_world_root, atol=1e-6)
    np.testing.assert_allclose(there.q, here.q, atol=1e-5)
    np.testing.assert_allclose(there.loss, here.loss, rtol=1e-4, atol=1e-10)
