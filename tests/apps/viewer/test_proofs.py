"""Documents of `validate` and `run`: read, matched to open grasps, and refused where they are not of these."""

from __future__ import annotations

import json
from collections.abc import Callable
from math import radians
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from grasp_refine.apps.viewer.collection import Collection
from grasp_refine.apps.viewer.columns import HELD, REASON
from grasp_refine.apps.viewer.pose import Pose
from grasp_refine.apps.viewer.proof_document import read_proofs
from grasp_refine.apps.viewer.proofs import with_proofs
from grasp_refine.apps.viewer.proving import Prover, prove

from grasp_refine.assets import resource_dir
from grasp_refine.cli import main
from grasp_refine.commands.sources import Sources
from grasp_refine.errors import GraspFileError
from grasp_refine.validation.trials import Reason

EXAMPLE = resource_dir("robots") / "allegro" / "example_mug.npz"


def opened(path: Path, *index: int) -> Collection:
    return Collection.of(Sources(index=index).load_from(path, 0, lambda text: None))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Documents of two commands, about two grasps."""
    folder = tmp_path_factory.mktemp("proofs")
    chosen = ["--index", "1", "0", "--friction", "0.15"]
    assert main(["validate", str(EXAMPLE), *chosen, "--json", str(folder / "validate.json")]) == 0
    run = ["run", "--geometry-only", "--validate", *chosen, "--out", str(folder)]
    assert main([*run, "--json", str(folder / "run.json")]) == 0
    return folder


def test_what_validate_wrote_is_what_a_proof_finds(folder: Path) -> None:
    # Whichever grasps are open, in whichever order.
    collection = opened(EXAMPLE, 0, 1, 2)
    found = read_proofs(folder / "validate.json").of(collection)
    assert sorted(found) == [0, 1]
    for number, read in found.items():
        scene = collection.scene(number)
        proved = prove(Prover(), scene, Pose(scene.T_world_root[0], scene.q[0]), read.protocol)
        assert (proved.verdict, proved.conditions, proved.closed_by) == (read.verdict, read.conditions, read.closed_by)
        assert [proved.words(tried) for tried in proved.tried] == [read.words(tried) for tried in read.tried]
        for one, other in zip(proved.tried, read.tried, strict=True):
            assert (one.direction, one.reason, one.links) == (other.direction, other.reason, other.links)
            np.testing.assert_equal((one.peak_m, one.time_s), (other.peak_m, other.time_s))
        assert read.motion is None
    table = with_proofs(collection, found).columns
    said = ["held" if found[number].held else "failed" for number in (0, 1)]
    assert table[HELD.key].values.tolist() == [*said, ""]
    reasons = [next((t.reason.label for t in found[n].tried if not t.held), "") for n in (0, 1)]
    assert table[REASON.key].values.tolist() == [*reasons, ""]
    assert "turned" in reasons


def test_what_run_wrote_is_of_its_input_before_and_of_its_output_after(folder: Path) -> None:
    proofs = read_proofs(folder / "run.json")
    before = proofs.of(opened(EXAMPLE, 0, 1))
    assert [before[n].verdict for n in (0, 1)] == [
        read_proofs(folder / "validate.json").of(opened(EXAMPLE, 0, 1))[n].verdict for n in (0, 1)
    ]
    assert before[0].closed_by == ""
    # Grasp 1 was asked for first.
    document = json.loads((folder / "run.json").read_text())
    after = proofs.of(opened(folder / "allegro_mug.npz"))
    assert sorted(after) == [0, 1] and [grasp["row"] for grasp in document["grasps"]] == [1, 0]
    for number, grasp in enumerate(document["grasps"]):
        simulation = grasp["simulation"]["after"]
        assert [tried.reason.label for tried in after[number].tried] == [d["reason"] for d in simulation["directions"]]
        assert after[number].held == simulation["success"]
        assert after[number].closed_by == "pregrasp and squeeze are our own"


Spoil = Callable[[dict[str, Any]], object]


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda d: d.update(command="bench align"), "is no document that run or validate wrote with --json"),
        (lambda d: d.update(schema=99), "schema must be 1, which this version reads, got 99"),
        (lambda d: d.update(grasps={}), "grasps must be a list, got {}"),
        (lambda d: d.update(config=None), "config must be an object, got null"),
        (lambda d: d["grasps"].append(3), r"grasps\[2\] must be an object, got 3"),
        (lambda d: d["grasps"][0].update(row=-1), r"grasps\[0\].row must be a whole number from 0 on, got -1"),
        (lambda d: d["grasps"][0].update(object=None), r"grasps\[0\].object must be a text, got null"),
        (
            lambda d: d["grasps"][0]["simulation"]["after"].update(directions=[]),
            r"grasps\[0\].simulation.after.directions must be a list with something in it, got \[\]",
        ),
        (
            lambda d: d["grasps"][0]["simulation"]["after"]["directions"][2].update(reason=["held"]),
            r"directions\[2\].reason must be among held, moved, .*, got \[\"held\"\]",
        ),
        (
            lambda d: d["grasps"][1]["simulation"]["after"]["directions"][2].update(direction="up"),
            r"directions\[2\].direction must be among \+x, .*, lift, got \"up\"",
        ),
        (
            lambda d: d["grasps"][1]["simulation"]["after"]["directions"][0].update(peak_m="far"),
            r"directions\[0\].peak_m must be a number below 1e\+12, or null, got \"far\"",
        ),
        (lambda d: d["config"]["protocol"].update(mass=0), "config.protocol.mass must be a number above 0, got 0"),
        (lambda d: d["config"]["protocol"].update(directions=[["+x"]]), "config.protocol.directions must be among"),
        (
            lambda d: d["config"]["files"][0].update(closing={"pregrasp": "whose"}),
            "config.files closing must be file or own for pregrasp and squeeze",
        ),
        (
            lambda d: (d["config"].update(protocol=None), d["grasps"][0]["simulation"]["after"].update(setting="soft")),
            'setting must be among force-closure, strict, tabletop, got "soft"',
        ),
    ],
)
def test_damaged_documents_are_refused_in_one_line(folder: Path, tmp_path: Path, spoil: Spoil, message: str) -> None:
    document = json.loads((folder / "validate.json").read_text())
    spoil(document)
    path = tmp_path / "spoilt.json"
    path.write_text(json.dumps(document))
    with pytest.raises(GraspFileError, match=message) as caught:
        read_proofs(path)
    assert str(caught.value).startswith(f"{path}: ") and "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "is no JSON document"),
        ("[" * 100_000, "is no JSON document"),
        ("[1, 2]", r"the document must be an object, got \[1, 2\]"),
        ("{}", "is no document that run or validate wrote with --json"),
    ],
)
def test_other_files_are_refused(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "other.json"
    path.write_text(text)
    with pytest.raises(GraspFileError, match=message):
        read_proofs(path)
    with pytest.raises(GraspFileError, match="cannot be read"):
        read_proofs(tmp_path / "missing.json")


def test_documents_about_other_grasps_are_refused(folder: Path, tmp_path: Path) -> None:
    other = opened(resource_dir("robots") / "allegro" / "example_bottle.npz", 0)
    proofs = read_proofs(folder / "validate.json")
    with pytest.raises(GraspFileError, match="is about another file than .*example_bottle.npz, or it was changed"):
        proofs.of(other)
    with pytest.raises(GraspFileError, match="none of its 2 grasps is among those that are open"):
        proofs.of(opened(EXAMPLE, 3))
    document = json.loads((folder / "run.json").read_text())
    for grasp in document["grasps"]:
        grasp["quality"]["after"] = 0.25
    (tmp_path / "run.json").write_text(json.dumps(document))
    with pytest.raises(GraspFileError, match=r"is of another refinement: it says quality 0.25 of mug 0, whose file"):
        read_proofs(tmp_path / "run.json").of(opened(folder / "allegro_mug.npz"))
    for grasp in document["grasps"]:
        grasp["simulation"] = {"before": None, "after": None}
    (tmp_path / "run.json").write_text(json.dumps(document))
    with pytest.raises(GraspFileError, match="nothing was simulated: `run` needs --validate"):
        read_proofs(tmp_path / "run.json").of(opened(EXAMPLE, 0))


def test_what_is_not_known_is_not_made_up(folder: Path, tmp_path: Path) -> None:
    """Without its configuration, a document still says which protocol was used, by name."""
    document = json.loads((folder / "validate.json").read_text())
    document["config"] = {}
    thrown = document["grasps"][0]["simulation"]["after"]
    thrown["closing"] = {"displacement_m": 0.089, "angle_rad": radians(30)}
    for direction in thrown["directions"]:
        direction.update(reason="thrown", time_s=None, displacement_m=None, angle_rad=None, peak_m=None, peak_rad=None)
    (tmp_path / "plain.json").write_text(json.dumps(document))
    found = read_proofs(tmp_path / "plain.json").of(opened(EXAMPLE, 0, 1))
    assert found[0].protocol.friction == 0.6 and found[0].closed_by == ""
    assert found[1].before_push == Reason.THROWN and found[1].watchable
    assert found[1].verdict == (
        "Does not hold: closing the hand moved the object by 89 mm and turned it by 30°, before any push"
    )
