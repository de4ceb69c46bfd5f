"""Pictures of the worst cases: small, of both poses, from one side, and never the end of a report."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image

from batch_rows import shard
from grasp_refine.assets.embedded import resource_dir
from grasp_refine.core.errors import MeshError
from grasp_refine.core.se3 import transform_from_pose
from grasp_refine.grasps.grasp_set import load_grasps, match_joints
from grasp_refine.hands.hand import Hand, load_hand
from grasp_refine.objects.object import Object, load_object
from grasp_refine_apps.batch import thumbnail as thumbnails
from grasp_refine_apps.batch.pictures import draw_cases
from grasp_refine_apps.batch.rows import read_rows
from grasp_refine_apps.batch.statistics import Statistics
from grasp_refine_apps.batch.thumbnail import HEIGHT, WIDTH, thumbnail
from grasp_refine_apps.batch.worst import Case
from grasp_refine_apps.report.drawing import best_side
from grasp_refine_apps.report.rasterizer import Model
from grasp_refine_apps.report.skeleton import Skeleton
from made_results import save_example_results
from refusals import assert_names, refused


def pixels(png: bytes) -> np.ndarray:
    with Image.open(io.BytesIO(png)) as image:
        return np.asarray(image.convert("RGB")).astype(int)


def shares(png: bytes) -> tuple[float, float, float]:
    """How much of a picture is background, bluish as the object, and orange as the fingertips."""
    r, g, b = pixels(png).transpose(2, 0, 1)
    return float((np.minimum(r, g) > 240).mean()), float((b - r > 12).mean()), float((r - b > 60).mean())


@pytest.fixture(scope="module")
def allegro() -> Hand:
    return load_hand("allegro")


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pictures that take less time."""
    monkeypatch.setattr(thumbnails, "WIDTH", WIDTH // 3)
    monkeypatch.setattr(thumbnails, "HEIGHT", HEIGHT // 3)


@pytest.fixture(scope="module")
def out(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of results."""
    return tmp_path_factory.mktemp("out")


@pytest.fixture(scope="module")
def cases(out: Path) -> tuple[Case, ...]:
    """Three grasps of a result file in it."""
    rows = read_rows(shard(0, save_example_results(out / "r.npz", 3)), out)
    statistics = Statistics.empty()
    statistics.add(rows)
    return statistics.worst()


def example(hand: Hand) -> tuple[np.ndarray, np.ndarray]:
    """The same grasp twice: poses (2, 4, 4) and joint values (2, n)."""
    grasps = load_grasps(resource_dir("robots") / "allegro" / "example_mug.npz").select([0, 0])
    return transform_from_pose(grasps.hand_pose), match_joints(grasps, hand)[0]


def test_a_case_is_drawn_before_and_after(cases: tuple[Case, ...], allegro: Hand, out: Path):
    heard = []
    picture, *_ = draw_cases(
        cases[:1],
        out,
        lambda case: (allegro, load_object("mug")),
        progress=lambda what, share: heard.append((what, share)),
    )
    assert picture.problem == "" and picture.case == cases[0]
    ((what, share),) = heard
    assert share == 0.0
    assert_names(what, "allegro", "mug")
    for png in (picture.before, picture.after):
        assert png.startswith(b"\x89PNG") and len(png) < 60_000 and pixels(png).shape == (HEIGHT, WIDTH, 3)
        background, blue, orange = shares(png)
        assert 0.1 < background < 0.8 and blue > 0.02 and orange > 0.005
    # The hand moved by up to a centimetre.
    assert 0.02 < (np.abs(pixels(picture.before) - pixels(picture.after)).max(axis=2) > 30).mean() < 0.6


def test_what_cannot_be_drawn_takes_its_picture_only(cases: tuple[Case, ...], allegro: Hand, out: Path):
    def load(case: Case) -> tuple[Hand, Object]:
        raise {0: MeshError("mug.obj: has\nholes"), 1: OSError("gone"), 2: ValueError("odd")}[cases.index(case)]

    for picture, reason in zip(draw_cases(cases, out, load), ("mug.obj: has holes", "gone", "odd"), strict=True):
        assert_names(picture.problem, reason)
    (picture,) = draw_cases(cases[:1], out / "moved", lambda case: (allegro, load_object("mug")))
    assert_names(picture.problem, out / "moved")


def test_a_grasp_that_is_not_finite_has_no_picture(allegro: Hand):
    T, q = example(allegro)
    T[1] *= np.nan
    with refused(ValueError, "finite"):
        thumbnail(Skeleton.of(allegro), load_object("mug"), T, q)


def test_a_side_is_chosen_from_which_no_wall_hides_what_should_be_seen():
    def block(size: tuple[float, float, float], x: float) -> Model:
        mesh = trimesh.creation.box(size)
        mesh.apply_translation([x, 0.0, 0.0])
        return Model.of(mesh, (1, 1, 1))

    for x in (0.1, -0.1):
        wall, parts = block((0.01, 1.0, 1.0), x), [block((0.05, 0.05, 0.05), 0.0), block((0.05, 0.05, 0.05), -x)]
        points = np.concatenate([model.vertices for model in (wall, *parts)])
        side = best_side([parts, [wall]], points, 1.0)
        assert side[0] * x < 0
        # A push along the direction of view would not be seen.
        across = best_side([parts, [wall]], points, 1.0, push=side)
        assert abs(across @ side) < 0.5
