"""FRoGGeR's pickles: poses of the hand from the joints of its arm, read without dill and Drake."""

import io
import pickle
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from grasp_refine.core.errors import GraspFileError
from grasp_refine.core.se3 import exp_so3, transform_from_pose
from grasp_refine.grasps.formats.reading import reading
from refusals import refused

TRANSFORM = "RigidTransform_[float]"
"""Name of Drake's class in pickles."""


@pytest.fixture
def dill(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Pickles as dill does where Drake is installed."""
    drake, package = ModuleType("pydrake.math"), ModuleType("dill._dill")

    class Transform:
        def __init__(self, matrix: np.ndarray) -> None:
            self.matrix = matrix

        def __getstate__(self) -> np.ndarray:
            return self.matrix

    def create(*parts: Any) -> None:
        """Stand for dill's function, whose name alone is pickled."""

    for module, name, value in ((drake, TRANSFORM, Transform), (package, "_create_array", create)):
        value.__module__, value.__qualname__, value.__name__ = module.__name__, name, name
        setattr(module, name, value)
        parent = ModuleType(module.__name__.partition(".")[0])
        monkeypatch.setitem(sys.modules, parent.__name__, parent)
        monkeypatch.setitem(sys.modules, module.__name__, module)

    class Pickler(pickle.Pickler):
        def reducer_override(self, value: Any) -> Any:
            return (create, (*value.__reduce__(), None)) if isinstance(value, np.ndarray) else NotImplemented

    def dumps(content: dict[str, Any], X_WO: np.ndarray) -> bytes:
        stream = io.BytesIO()
        settings = {"obj_settings": {"name": "mug", "X_WO": Transform(X_WO[:3])}}
        Pickler(stream, 5).dump(content | settings)
        return stream.getvalue()

    return dumps


def contents(q: np.ndarray, **others: Any) -> dict[str, Any]:
    return {"q_stars": q, "model_settings": {"name": "fr3_arm_algr_rh"}, **others}


def test_the_hand_of_a_straight_arm_hangs_above_the_base(tmp_path: Path, dill: Any):
    """The arm is 333 + 316 + 384 mm high, 88 mm out of its axis there, and the hand 215 mm below."""
    turn, q = 0.3, np.zeros((2, 23))
    q[1, 0], q[:, 5], q[:, 7:] = turn, -np.pi / 2, np.arange(16) / 16
    X_WO = np.eye(4)
    X_WO[:3, 3] = [0.7, 0.0, 0.1]
    file = tmp_path / "exp.pkl"
    file.write_bytes(dill(contents(q, pick_success=np.array([True, False])), X_WO))
    read = reading(file)
    grasps, T = read.grasps, transform_from_pose(read.grasps.hand_pose)
    assert (read.format.name, grasps.hand, grasps.base_link) == ("frogger", "allegro", "base_link")
    assert grasps.object.tolist() == ["mug"] * 2 and grasps.scale.tolist() == [1.0] * 2
    np.testing.assert_array_equal(grasps.q, q[:, 7:])
    np.testing.assert_array_equal(grasps.labels["success"], [1.0, 0.0])
    flat = np.array([[np.pi, 0.0, 0.0], [0.0, 0.0, -np.pi / 4], [0.0, 0.0, turn]])
    R = exp_so3(flat)
    np.testing.assert_allclose(T[0, :3, :3], R[0] @ R[1], atol=1e-12)
    np.testing.assert_allclose(T[1, :3, :3], R[2] @ R[0] @ R[1], atol=1e-12)
    world = T[:, :3, 3] + X_WO[:3, 3]
    height = 0.333 + 0.316 + 0.384 - 0.215
    out = 0.088 * np.array([[1.0, 0.0], [np.cos(turn), np.sin(turn)]])
    np.testing.assert_allclose(world, np.c_[out, [height] * 2], atol=1e-12)


def test_the_pose_of_the_object_turns_the_grasps(tmp_path: Path, dill: Any):
    q, X_WO, file = np.zeros((1, 23)), np.eye(4), tmp_path / "exp.pkl"
    file.write_bytes(dill(contents(q), X_WO))
    before = transform_from_pose(reading(file).grasps.hand_pose)
    X_WO[:3, :3], X_WO[:3, 3] = exp_so3(np.array([0.1, 0.2, 0.3])), [0.7, 0.0, 0.1]
    file.write_bytes(dill(contents(q), X_WO))
    np.testing.assert_allclose(X_WO @ transform_from_pose(reading(file).grasps.hand_pose), before, atol=1e-12)


def test_other_models_and_objects_of_classes_are_refused(tmp_path: Path, dill: Any):
    file = tmp_path / "exp.pkl"
    other = contents(np.zeros((1, 23))) | {"model_settings": {"name": "bh280"}}
    file.write_bytes(dill(other, np.eye(4)))
    with refused(GraspFileError, file, "'bh280'", "fr3_arm_algr_rh"):
        reading(file)
    file.write_bytes(dill(contents(np.zeros((1, 16))), np.eye(4)))
    with refused(GraspFileError, file, "q_stars", "23"):
        reading(file)
    file.write_bytes(dill(contents(np.zeros((1, 23)), path=Path("a")), np.eye(4)))
    with refused(GraspFileError, file, "pathlib"):
        reading(file)
