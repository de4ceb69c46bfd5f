"""Saving the shown grasp: every format that can hold it, read again, and an error for those that cannot."""

import io
import zipfile
from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial
from pathlib import Path

import numpy as np
import pytest

from grasp_refine.closing.motion import closing_motion
from grasp_refine.core.errors import GraspFileError
from grasp_refine.core.se3 import exp_se3, pose_from_transform
from grasp_refine.grasps.formats import agreement
from grasp_refine.grasps.formats.agreement import fingertip_distances
from grasp_refine.grasps.formats.reading import reading
from grasp_refine.grasps.grasp_set import GraspSet, Stage, load_grasps
from grasp_refine.hands.hand import Hand, load_hand
from grasp_refine.objects.object import load_object
from grasp_refine.problem.problem import Problem
from grasp_refine.scene.scene import Scene
from grasp_refine_apps.viewer.files.saving import MAX_STEM_BYTES, Saved, grasp_file, grasp_set, grasp_sets
from grasp_refine_apps.viewer.model.collection import Collection
from grasp_refine_apps.viewer.model.pose import Pose, Target
from made_results import plain_outcome
from refusals import refused

BASES = {"shadow": "palm", "allegro": "base_link", "leap": "palm_lower"}
HOLDS = {
    "shadow": ("ours", "dexgraspbench", "bodex", "dexonomy", "dexgraspnet"),
    "allegro": ("ours", "dexgraspbench", "bodex", "dexonomy"),
    "leap": ("ours", "dexgraspbench", "bodex", "dexonomy", "leap_cache"),
}
"""Which formats hold grasps of which of our hands."""


@cache
def below(name: str, base_link: str) -> Hand:
    return load_hand(name, base_link=base_link, candidates=16)


def hand(name: str) -> Hand:
    return below(name, BASES[name])


@cache
def shown(name: str) -> GraspSet:
    """A grasp that was edited, with its stages and two targets."""
    own = hand(name)
    pose = Pose(exp_se3(np.array([0.02, -0.01, 0.11, 0.4, -1.2, 0.7])), np.clip(own.rest + 0.1, own.lower, own.upper))
    scene = Scene(own, load_object("sphere:0.03", candidates=64), np.eye(4)[None], own.rest[None])
    link = own.contacts[0].link
    targets = (
        Target(link, np.array([0.01, 0.02, 0.03]), np.array([0.03, 0.0, 0.0])),
        Target(own.contacts[1].link, np.array([0.0, 0.0, 0.01]), np.array([0.0, 0.03, 0.0])),
    )
    return grasp_set(scene, pose, "sphere:0.03", 1.0, targets)


@pytest.fixture
def unpacked(tmp_path: Path) -> Callable[[Saved], Path]:
    """Puts what the browser got where it can be read."""

    def unpacked(saved: Saved) -> Path:
        if not saved.name.endswith(".zip"):
            (tmp_path / saved.name).write_bytes(saved.content)
            return tmp_path / saved.name
        with zipfile.ZipFile(io.BytesIO(saved.content)) as archive:
            archive.extractall(tmp_path / "there")
        return tmp_path / "there"

    return unpacked


@pytest.mark.parametrize(("name", "format_name"), [(name, to) for name, all in HOLDS.items() for to in all])
def test_every_format_gives_the_grasp_back(name: str, format_name: str, unpacked: Callable[[Saved], Path]):
    saved = grasp_file(hand(name), shown(name), format_name)
    again = reading(unpacked(saved), format=format_name, hand=hand(name))
    assert again.format.name == format_name
    distance = fingertip_distances(shown(name), again.grasps, partial(below, name))
    assert distance.shape == (1,) and distance[0] < 1e-6
    assert "/" not in saved.name and ":" not in saved.name
    assert saved.name.endswith({"ours": ".npz", "leap_cache": "_s10.npy"}.get(format_name, ".zip"))
    # What a format has no place for is said.
    assert any("targets" in note for note in saved.notes) == (format_name != "ours")


@pytest.mark.parametrize(("scale", "end"), [(1.0, "_s10.npy"), (1.05, "_s105.npy"), (0.9, "_s09.npy")])
def test_the_name_of_a_leap_cache_ends_in_its_scale(scale: float, end: str):
    grasps = replace(shown("leap"), scale=np.array([scale]))
    assert grasp_file(hand("leap"), grasps, "leap_cache").name.endswith(end)


def test_our_format_holds_all_of_it(unpacked: Callable[[Saved], Path]):
    grasps = shown("allegro")
    saved = grasp_file(hand("allegro"), grasps, "ours")
    assert saved.name == "allegro_sphere_0.03_ours.npz"
    again = load_grasps(unpacked(saved))
    for key, value in grasps.arrays().items():
        np.testing.assert_array_equal(again.arrays()[key], value)
    assert again.targets is not None and again.targets.links == tuple(c.link for c in hand("allegro").contacts[:2])


def test_a_format_that_cannot_hold_it_and_an_unknown_one_are_refused():
    for name, named in (
        ("leap_cache", ("leap_cache", "'allegro'", " leap ")),
        ("stl", ("'stl'", "ours, dexgraspbench")),
    ):
        with refused(GraspFileError, *named):
            grasp_file(hand("allegro"), shown("allegro"), name)


def test_stages_come_from_the_refinement_or_the_file_while_the_pose_is_theirs(problem: Problem):
    """Else they are generated."""
    (group,) = problem.groups
    own = closing_motion(group.scene)
    poses = [pose_from_transform(own.T_world_root[:, stage]) for stage in (0, 2)]
    stages = [Stage(pose, own.q[:, stage] + 0.01 * (1 + stage)) for pose, stage in zip(poses, (0, 2), strict=True)]
    grasps = replace(group.grasps, pregrasp=stages[0], squeeze=stages[1])
    collection = Collection.of(replace(problem, groups=(replace(group, grasps=grasps),)))
    works = {number: collection.work(number) for number in (2, 0, 1)}
    moved = Pose(works[0].pose.T_object_root, works[0].pose.q + 0.01)
    outcome = plain_outcome(1, links=len(group.scene.links), q=moved.q[None] + 0.02)
    works[0] = replace(works[0], pose=moved)
    works[1] = replace(works[1], pose=moved, outcome=outcome)
    found = grasp_sets(collection, works)
    np.testing.assert_allclose(found.q, [works[2].pose.q, moved.q, moved.q])
    generated = closing_motion(replace(group.scene.select(np.array([0])), q=moved.q[None])).q[0]
    for stage, at in ((found.pregrasp, 0), (found.squeeze, -1)):
        np.testing.assert_allclose(stage.q[0], stages[at].q[2])
        np.testing.assert_allclose(stage.q[1], generated[at], atol=1e-9)
        np.testing.assert_allclose(stage.q[2], outcome.stage_q[0, at])


def test_a_grasp_that_is_not_finite_is_not_saved():
    own = hand("allegro")
    scene = Scene(own, load_object("sphere:0.03", candidates=64), np.eye(4)[None], own.rest[None])
    with refused(GraspFileError, "finite"):
        grasp_set(scene, Pose(np.full((4, 4), np.nan), own.rest), "ball", 1.0)


def test_what_is_read_as_another_grasp_is_not_handed_out(monkeypatch: pytest.MonkeyPatch):
    def astray(grasps: GraspSet, *_: object) -> np.ndarray:
        return np.full(len(grasps), 2e-6)

    monkeypatch.setattr(agreement, "fingertip_distances", astray)
    with refused(GraspFileError, "2e-06 m", "1e-06 m"):
        grasp_file(hand("allegro"), shown("allegro"), "ours")


def test_a_name_from_a_file_names_no_folder():
    grasps = replace(shown("allegro"), object=np.array(["../../etc/cron.d/x y"]), hand="../allegro")
    saved = grasp_file(hand("allegro"), grasps, "ours")
    assert saved.name == "_allegro_.._.._etc_cron.d_x_y_ours.npz"
    long = replace(shown("allegro"), object=np.array(["x" * 150]))
    assert len(grasp_file(hand("allegro"), long, "dexonomy").name) == MAX_STEM_BYTES + len(".zip")
