"""Measuring grasps whose files have no measures."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from grasp_refine.assets.embedded import resource_dir
from grasp_refine.measures.metrics import metrics
from grasp_refine.objects.region_spec import contact_regions
from grasp_refine.problem.load import load_problem
from grasp_refine.problem.spec import ProblemSpec
from grasp_refine.scene.task import Task
from grasp_refine_apps.viewer.jobs import measuring
from grasp_refine_apps.viewer.jobs.measuring import measured_columns, unmeasured, with_measures
from grasp_refine_apps.viewer.jobs.worker import Stopped
from grasp_refine_apps.viewer.model.collection import Collection
from made_results import save_example_results

EXAMPLE = resource_dir("robots") / "allegro" / "example_rounded_box.npz"


def ignore(*told: object) -> None: ...


@pytest.fixture(scope="module")
def collection() -> Collection:
    return Collection.of(load_problem(ProblemSpec(index=(3, 0, 2, 1), grasps=EXAMPLE)))


def test_measures_are_as_in_validate_each_in_its_place(collection: Collection, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(measuring, "BATCH_SIZE", 3)
    shares = []
    found = with_measures(collection, lambda share, what: shares.append(share), ignore)
    assert shares == [0.0, 0.75]
    assert not unmeasured(found).any()
    assert unmeasured(collection).all()
    for i in range(len(collection)):
        scene = collection.scene(i)
        alone = metrics(scene.hand, scene.object, scene.T_world_root, scene.q)
        for key, name in measured_columns().items():
            assert found.columns[key].values[i] == pytest.approx(
                getattr(alone, name)[0], rel=1e-9, abs=1e-12, nan_ok=True
            ), key


def test_contacts_outside_of_the_regions_cost_quality(collection: Collection) -> None:
    (group,) = collection.problem.groups
    regions = contact_regions(group.scene.object, touch=f"above:z={group.scene.object.mesh.bounds[1, 2] - 1e-4:g}")
    asked = replace(group, scene=replace(group.scene, task=Task(touch=regions.touch)))
    problem = replace(collection.problem, groups=(asked,))
    found = with_measures(replace(collection, problem=problem), ignore, ignore)
    quality = with_measures(collection, ignore, ignore).columns["quality_after"].values
    touching = found.columns["quality_after"].values < quality
    assert touching.any() and (found.columns["quality_after"].values[touching] == 0.0).all()


def test_what_a_file_says_is_not_measured(tmp_path: Path) -> None:
    path = save_example_results(tmp_path / "results.npz", 4)
    collection = Collection.of(load_problem(ProblemSpec(grasps=path)))
    assert not unmeasured(collection).any()
    assert with_measures(collection, ignore, ignore) is collection


def test_what_was_measured_before_an_interruption_is_kept(
    collection: Collection, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(measuring, "BATCH_SIZE", 1)
    checks, kept = [], []

    def check() -> None:
        checks.append(None)
        if len(checks) == 3:
            raise Stopped

    with pytest.raises(Stopped):
        with_measures(collection, ignore, check, kept.append)
    (part,) = kept
    assert unmeasured(part).tolist() == [False, False, True, True]
    whole = with_measures(collection, ignore, ignore)
    rest = with_measures(part, ignore, ignore)
    for key in measured_columns():
        assert np.array_equal(rest.columns[key].values, whole.columns[key].values, equal_nan=True)


def test_a_grasp_that_is_not_finite_is_not_measured(collection: Collection) -> None:
    (group,) = collection.problem.groups
    scene = replace(group.scene, q=np.where(np.arange(4)[:, None] == 1, np.nan, group.scene.q))
    problem = replace(collection.problem, groups=(replace(group, scene=scene),))
    found = with_measures(replace(collection, problem=problem), ignore, ignore)
    known = found.columns["quality_after"].known
    assert np.flatnonzero(~known).tolist() == np.flatnonzero(collection.member == 1).tolist()
