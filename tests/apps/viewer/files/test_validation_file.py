"""Documents of `validate` and `run`: read, matched to open grasps, and refused where they are not of these."""

import json
from math import radians
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from grasp_refine.assets.embedded import resource_dir
from grasp_refine.core.errors import GraspFileError
from grasp_refine.problem.load import load_problem
from grasp_refine.problem.spec import ProblemSpec
from grasp_refine.results.margins_document import margins_entry
from grasp_refine.validation.trials import Reason
from grasp_refine_apps.cli import main
from grasp_refine_apps.viewer.files.validation_file import read_validation
from grasp_refine_apps.viewer.jobs.validating import PosedGrasp, run_trial, world_cache
from grasp_refine_apps.viewer.model.collection import Collection
from grasp_refine_apps.viewer.model.columns import HELD, REASON
from grasp_refine_apps.viewer.model.pose import Pose
from made_results import made_margins
from open_viewer import ignored
from refusals import assert_names, refused

EXAMPLE = resource_dir("robots") / "allegro" / "example_mug.npz"


AFTER = ("after",)
"""Beginning of a place in the result of a simulation: number of the grasp, and of the direction."""


def opened(path: Path, *index: int) -> Collection:
    return Collection.of(load_problem(ProblemSpec(index=index, grasps=path)))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Documents of two commands, about two grasps."""
    folder = tmp_path_factory.mktemp("documents")
    (folder / "short.toml").write_text("checks = 2\nfriction = 0.15\n")
    chosen = ["--index", "1", "0", "--protocol", str(folder / "short.toml")]
    assert main(["validate", str(EXAMPLE), *chosen, "--json", str(folder / "validate.json")]) == 0
    run = ["run", "--geometry-only", "--validate", *chosen, "--out", str(folder)]
    assert main([*run, "--json", str(folder / "run.json")]) == 0
    return folder


def test_what_validate_wrote_is_what_a_trial_finds(folder: Path) -> None:
    # Whichever grasps are open, in whichever order.
    collection = opened(EXAMPLE, 0, 1, 2)
    found = read_validation(folder / "validate.json").of(collection)
    assert sorted(found) == [0, 1]
    for number, read in found.items():
        scene = collection.scene(number)
        grasp = PosedGrasp(scene, Pose(scene.T_world_root[0], scene.q[0]))
        trial = run_trial(world_cache(), grasp, read.protocol, ignored())
        assert (trial.verdict, trial.conditions, trial.closed_by) == (read.verdict, read.conditions, read.closed_by)
        assert [trial.words(result) for result in trial.results] == [read.words(result) for result in read.results]
        for one, other in zip(trial.results, read.results, strict=True):
            assert (one.direction, one.reason, one.links) == (other.direction, other.reason, other.links)
            np.testing.assert_equal((one.peak_m, one.time_s), (other.peak_m, other.time_s))
        assert read.motion is None
    table = collection.with_trials(found).columns
    said = ["held" if found[number].held else "failed" for number in (0, 1)]
    assert table[HELD.key].values.tolist() == [*said, ""]
    reasons = [next((t.reason.label for t in found[n].results if not t.held), "") for n in (0, 1)]
    assert table[REASON.key].values.tolist() == [*reasons, ""]
    assert any(reasons)


def test_what_run_wrote_is_of_its_input_before_and_of_its_output_after(folder: Path) -> None:
    read = read_validation(folder / "run.json")
    before = read.of(opened(EXAMPLE, 0, 1))
    assert [before[n].verdict for n in (0, 1)] == [
        read_validation(folder / "validate.json").of(opened(EXAMPLE, 0, 1))[n].verdict for n in (0, 1)
    ]
    assert before[0].closed_by == ""
    # Grasp 1 was asked for first.
    document = json.loads((folder / "run.json").read_text())
    after = read.of(opened(folder / "allegro_mug.npz"))
    assert sorted(after) == [0, 1] and [grasp["row"] for grasp in document["grasps"]] == [1, 0]
    for number, grasp in enumerate(document["grasps"]):
        simulation = grasp["simulation"]["after"]
        assert [result.reason.label for result in after[number].results] == [
            d["reason"] for d in simulation["directions"]
        ]
        assert after[number].held == simulation["success"]
        assert_names(after[number].closed_by, "pregrasp", "squeeze")


@pytest.mark.parametrize(
    ("place", "changes", "named"),
    [
        ((), {"command": "bench align"}, ("run", "validate", "--json")),
        ((), {"schema": 99}, ("schema", "1", "99")),
        ((), {"grasps": {}}, ("grasps", "{}")),
        ((), {"grasps": [3]}, ("grasps[0]", "3")),
        ((), {"config": None}, ("config", "null")),
        (("grasps", 0), {"row": -1}, ("grasps[0].row", "-1")),
        (("grasps", 0), {"object": None}, ("grasps[0].object", "null")),
        ((*AFTER, 0), {"directions": []}, ("grasps[0].simulation.after.directions", "[]")),
        ((*AFTER, 0, 2), {"reason": ["held"]}, ("directions[2].reason", "held, moved, ", '["held"]')),
        ((*AFTER, 1, 2), {"direction": "up"}, ("grasps[1]", "directions[2].direction", "+x, ", "lift", '"up"')),
        ((*AFTER, 1, 0), {"peak_m": "far"}, ("directions[0].peak_m", "1e+12", "null", '"far"')),
        ((*AFTER, 1, 0), {"peak_m": 1e12}, ("directions[0].peak_m", "1e+12")),
        (("config", "protocol"), {"mass": 0}, ("config.protocol.mass", "0")),
        (("config", "protocol"), {"directions": [["+x"]]}, ("config.protocol.directions", "+x")),
        (("config", "files", 0), {"closing": {"pregrasp": "whose"}}, ("config.files", "file", "own", "squeeze")),
    ],
)
def test_damaged_documents_are_refused_in_one_line(
    folder: Path, tmp_path: Path, place: tuple, changes: dict[str, Any], named: tuple[str, ...]
) -> None:
    document = part = json.loads((folder / "validate.json").read_text())
    if place[:1] == AFTER:
        part = document["grasps"][place[1]]["simulation"]["after"]
        place = ("directions", *place[2:]) if len(place) > 2 else ()
    for key in place:
        part = part[key]
    part.update(changes)
    path = tmp_path / "spoilt.json"
    path.write_text(json.dumps(document))
    with refused(GraspFileError, *named) as caught:
        read_validation(path)
    assert str(caught.value).startswith(f"{path}: ")


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("", ("JSON",)),
        ("[" * 100_000, ("JSON",)),
        ("[1, 2]", ("[1, 2]",)),
        ("{}", ("run", "validate", "--json")),
    ],
)
def test_other_files_are_refused(tmp_path: Path, text: str, named: tuple[str, ...]) -> None:
    path = tmp_path / "other.json"
    path.write_text(text)
    with refused(GraspFileError, path, *named):
        read_validation(path)
    with refused(GraspFileError, tmp_path / "missing.json"):
        read_validation(tmp_path / "missing.json")


def test_documents_about_other_grasps_are_refused(folder: Path, tmp_path: Path) -> None:
    other = opened(resource_dir("robots") / "allegro" / "example_bottle.npz", 0)
    read = read_validation(folder / "validate.json")
    with refused(GraspFileError, folder / "validate.json", "example_bottle.npz"):
        read.of(other)
    with refused(GraspFileError, folder / "validate.json", "2 grasps"):
        read.of(opened(EXAMPLE, 3))
    document = json.loads((folder / "run.json").read_text())
    for grasp in document["grasps"]:
        grasp["quality"]["after"] = 0.25
    (tmp_path / "run.json").write_text(json.dumps(document))
    with refused(GraspFileError, tmp_path / "run.json", "quality 0.25", "mug 0"):
        read_validation(tmp_path / "run.json").of(opened(folder / "allegro_mug.npz"))
    for grasp in document["grasps"]:
        grasp["simulation"] = {"before": None, "after": None}
    (tmp_path / "run.json").write_text(json.dumps(document))
    with refused(GraspFileError, tmp_path / "run.json", "--validate"):
        read_validation(tmp_path / "run.json").of(opened(EXAMPLE, 0))


def test_what_is_not_known_is_not_made_up(folder: Path, tmp_path: Path) -> None:
    """Without its configuration, a document still says which protocol was used, by name."""
    document = json.loads((folder / "validate.json").read_text())
    document["config"] = {}
    for grasp in document["grasps"]:
        grasp["simulation"]["after"]["protocol"] = "dexgraspbench"
    ejected = document["grasps"][0]["simulation"]["after"]
    ejected["closing"] = {"displacement_m": 0.089, "angle_rad": radians(30)}
    for direction in ejected["directions"]:
        direction.update(reason="ejected while closing")
        direction.update(dict.fromkeys(("time_s", "displacement_m", "angle_rad", "peak_m", "peak_rad")))
    (tmp_path / "plain.json").write_text(json.dumps(document))
    found = read_validation(tmp_path / "plain.json").of(opened(EXAMPLE, 0, 1))
    assert found[0].protocol.friction == 0.6 and found[0].closed_by == ""
    assert found[1].before_push == Reason.EJECTED_WHILE_CLOSING and found[1].watchable
    assert_names(found[1].verdict, "89 mm", "30°")


def test_margins_are_as_in_the_document(folder: Path, tmp_path: Path) -> None:
    document, margins = json.loads((folder / "validate.json").read_text()), made_margins()
    for i in (0, 1):
        document["grasps"][i]["margins"] = margins_entry(margins, i)
    (tmp_path / "margins.json").write_text(json.dumps(document))
    found = read_validation(tmp_path / "margins.json").of(opened(EXAMPLE, 1, 0))
    for number, trial in found.items():
        read = trial.margins
        assert read is not None and read.count == 8
        assert read.probability == margins.probability[number, 0]
        assert read.interval == tuple(margins.interval[number, 0])
        assert read.worst == margins.worst[number]
    known = found[1].margins
    assert known is not None and known.limits == {
        "lowest_friction": 0.4,
        "largest_force_n": 2.0,
        "largest_torque_nm": 0.1,
    }
    assert_names(known.text, "75 %", "8", "mass", "25 %", "0.4", "2 N")
    # A grasp that held at no friction has no lowest one.
    assert found[0].margins is not None and "lowest_friction" not in found[0].margins.limits
    document["grasps"][0]["margins"]["trials"]["all"]["interval"] = [0.5]
    (tmp_path / "damaged.json").write_text(json.dumps(document))
    with pytest.raises(GraspFileError, match="interval"):
        read_validation(tmp_path / "damaged.json")
