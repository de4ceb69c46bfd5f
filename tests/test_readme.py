"""README.md and the documentation are true: their Python runs, tables are complete, links and options exist."""

from __future__ import annotations

import re
import shutil
import tomllib
from pathlib import Path

import numpy as np
import pytest

import grasp_refine as gr
from grasp_refine.assets.embedded import resource_dir
from grasp_refine.grasps.grasp_set import CONTACT_KEYS, OTHER_STAGES, REQUIRED, TARGET_KEYS, load_grasps
from grasp_refine.hands.files.hand_toml import ARM_TOML, HAND_TOML
from grasp_refine.hands.hand import load_hand
from grasp_refine.results.verdict import should_hold
from grasp_refine.scene.protocols.contact_model import ContactModel
from grasp_refine.scene.protocols.protocol_file import load_protocol
from grasp_refine.scene.protocols.strict import STRICT
from grasp_refine.scene.scene_file import load_scene
from grasp_refine_apps.batch.jobs import read_jobs
from grasp_refine_apps.cli import main
from grasp_refine_apps.commands.inputs import Inputs
from readme import PAGES, PYTHON, TEXT, blocks, extension_blocks, facade_blocks, run_python, section

MEASURED = "Performance"
"""Section of README with a table of what was measured."""

BENCHES = tuple(
    f"bench {name}" for name in ("align", "queries", "stability", "grasp", "scans", "success", "transfer", "--gate")
)


def test_the_example_in_python_runs():
    names = run_python("Config(starts=6", {"gr": gr})
    examples = names["examples"]
    assert should_hold(examples.quality[:, 1]).all(), "the quality that it asks for is reached"
    assert gr.simulate(examples).held[:, 1].all()


@pytest.mark.parametrize("mark", ["T_ball.grad", "sum().backward()"])
def test_the_examples_of_the_layer_run(mark: str):
    names = run_python(mark)
    gradient = names["T_ball"].grad
    assert gradient.isfinite().all() and gradient.abs().max() > 0
    # The ball is 8 cm from the axis of a mug of 4 cm, and has a radius of 2 cm.
    assert mark != "T_ball.grad" or names["witness"].distance.item() == pytest.approx(0.02, abs=5e-4)


def test_the_loss_of_ones_own_is_minimised():
    witness = run_python("optimizer.step")["witness"]
    assert witness.distance.shape == (4, 4)
    assert (witness.distance - 0.002).abs().max() < 1e-3
    height = witness.point_b[..., 2]
    assert (height.amax(1) - height.amin(1)).max() < 3e-3


@pytest.mark.slow
def test_the_facade_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    import grasp_refine

    monkeypatch.chdir(tmp_path)
    shown: list[object] = []
    monkeypatch.setattr(grasp_refine, "view", shown.append, raising=False)
    shutil.copy(resource_dir("robots") / "allegro" / "allegro.urdf", "my_hand.urdf")
    names: dict[str, object] = {}
    for block in facade_blocks():
        # Three grasps show what sixteen do.
        few = re.sub(r"(sample_grasps\(hand, \w+, )\d+", r"\g<1>3", block)
        exec(compile(few, "python.md", "exec"), names)
    assert len(load_grasps("refined.npz")) == 3 and len(shown[0]) == 3
    # One of the three ends with contacts on two edges of the box, which tips out of the hand.
    assert names["held"].sum() >= 2 and len(load_grasps("held.npz")) == 3 and len(load_grasps("two.npz")) == 2


TOML = (
    "rest_pose",
    "mount =",
    "[[job]]",
    'based_on = "strict"',
    "mujoco-default",
    "heavy.toml",
    "[[body]]",
    "entry-points",
    "index_joint_0",
)
"""Parts of the blocks of TOML that a test reads by themselves."""


def test_the_protocol_on_default_contacts_is_read(tmp_path: Path):
    (block,) = (block for block in blocks("toml") if "mujoco-default" in block)
    (tmp_path / "own.toml").write_text(block)
    assert load_protocol(str(tmp_path / "own.toml")).contact == ContactModel("pyramidal", 10.0, 0)


def test_a_table_is_read_by_the_file_that_names_its_columns(tmp_path: Path):
    (block,) = (block for block in blocks("toml") if "index_joint_0" in block)
    (tmp_path / "grasps.toml").write_text(block.replace("grasps.parquet", "grasps.csv"))
    (tmp_path / "grasps.csv").write_text("x,y,z,qx,qy,qz,qw,object_id,q_index_0,held\n10,20,30,0,0,0.6,0.8,mug,90,1\n")
    grasps = gr.load_grasps(tmp_path / "grasps.toml")
    np.testing.assert_allclose(grasps.hand_pose, [[0.01, 0.02, 0.03, 0.8, 0.0, 0.0, 0.6]])
    np.testing.assert_allclose(grasps.q, [[np.pi / 2]])
    assert (grasps.joint_names, grasps.base_link) == (("index_joint_0",), "palm")
    assert (grasps.object.tolist(), grasps.scale.tolist()) == (["mug"], [0.001])
    assert grasps.labels["success"].tolist() == [1.0]


@pytest.mark.parametrize(("language", "marks"), [("python", PYTHON), ("toml", TOML)])
def test_no_block_is_left_out(language: str, marks: tuple[str, ...]):
    run = (*facade_blocks(), *extension_blocks())
    others = [block for block in blocks(language) if block not in run]
    assert [[mark in block for mark in marks].count(True) for block in others] == [1] * len(marks)


def test_the_arm_toml_is_read(tmp_path: Path):
    (block,) = (block for block in blocks("toml") if "mount =" in block)
    (tmp_path / "arm.urdf").write_text(
        '<robot name="my"><link name="base"/><link name="tool0"/><joint name="turn" type="revolute">'
        '<parent link="base"/><child link="tool0"/><axis xyz="0 0 1"/>'
        '<limit lower="-1" upper="1" effort="1" velocity="1"/></joint></robot>'
    )
    (tmp_path / ARM_TOML).write_text(block)
    arm = load_hand(tmp_path)
    assert arm.mount == "tool0" and arm.actuator.kp.tolist() == [2000.0]


def test_the_hand_toml_has_only_known_keys(tmp_path: Path):
    (block,) = (block for block in blocks("toml") if "rest_pose" in block)
    raw = tomllib.loads(block)
    assert set(raw) == {"urdf", "base_link", "rest_pose", "contact"}
    joints = "".join(
        f'<joint name="{child}_joint" type="revolute"><parent link="palm"/><child link="{child}"/>'
        '<axis xyz="1 0 0"/><limit lower="0" upper="2" effort="1" velocity="1"/></joint>'
        f'<link name="{child}"><collision><geometry><sphere radius="0.01"/></geometry></collision></link>'
        for child in ("thumb_tip", "other_tip")
    ).replace("thumb_tip_joint", "thumb_joint")
    (tmp_path / "my_hand.urdf").write_text(f'<robot name="my"><link name="palm"/>{joints}</robot>')
    (tmp_path / HAND_TOML).write_text(block)
    hand = load_hand(tmp_path)
    assert [contact.link for contact in hand.contacts] == ["thumb_tip"]
    assert dict(zip(hand.joint_names, hand.rest, strict=True))["thumb_joint"] == 1.2


def test_the_job_list_can_be_read(tmp_path: Path):
    (block,) = (block for block in blocks("toml") if "[[job]]" in block)
    for name in ("right/a.npz", "right/b.npz", "hands/right.urdf", "meshes/mug.obj"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    path = tmp_path / "jobs.toml"
    path.write_text(block)
    jobs = read_jobs([str(path)], Inputs())
    assert [job.name for job in jobs] == ["right hand/a", "right hand/b", "sample_1000"]
    assert [job.inputs.objects for job in jobs] == [tmp_path / "meshes"] * 3


def test_the_protocol_and_the_task_can_be_read(tmp_path: Path):
    block, task = (
        next(block for block in blocks("toml") if mark in block) for mark in ('based_on = "strict"', "heavy.toml")
    )
    (tmp_path / "heavy.toml").write_text(block)
    protocol = load_protocol(str(tmp_path / "heavy.toml"))
    assert protocol.name == "heavy" and protocol.friction == STRICT.friction and protocol.contact.cone == "pyramidal"
    (tmp_path / "task.toml").write_text(task)
    assert gr.load_task(str(tmp_path / "task.toml")).protocol == protocol


def test_the_scene_can_be_read(tmp_path: Path):
    (block,) = (block for block in blocks("toml") if "[[body]]" in block)
    (tmp_path / "desk.toml").write_text(block)
    scene = load_scene(tmp_path / "desk.toml")
    assert scene.object == "mug" and scene.T_world_object[:3, 3].tolist() == [0.1, 0.0, 0.7]
    assert [(one.name, one.margin, one.movable) for one in scene.bodies] == [
        ("table", 0.003, False), ("wall", 0.003, False), ("tea tin", 0.003, True), ("bottle", 0.01, False)
    ]  # fmt: skip
    assert scene.bodies[2].mass == 0.25


def test_the_table_of_grasp_files_is_complete():
    lines = section("docs/pages/reference/files.md", "Grasp files").splitlines()
    listed = set(re.findall(r"`(\w+)`", "".join(line.split("|")[1] for line in lines if "|" in line)))
    stages = {f"{stage}_{key}" for stage in OTHER_STAGES for key in ("pose", "q")}
    assert listed == {*REQUIRED, *TARGET_KEYS, *CONTACT_KEYS, *stages, "schema", "hand_pose_before", "q_before"}


def test_the_options_are_as_in_the_commands(capsys: pytest.CaptureFixture[str]):
    known = set()
    methods = "run --solver levenberg-marquardt --solver descent --solver adam --derivative distance"
    others = ("batch", "validate", "view", "hands", "scenes", "convert", "export", "assets fetch", *BENCHES)
    for command in ("run", methods, *others):
        with pytest.raises(SystemExit):
            main([*command.split(), "--help"])
        known |= set(re.findall(r"--[a-z][\w.-]*", capsys.readouterr().out))
    named = set(re.findall(r"`(--[a-z][\w.-]*)", TEXT)) | set(re.findall(r" (--[a-z][\w.]*-?[\w.]*) ", TEXT))
    elsewhere = {"--help", "--scheduler-file", "--nworkers", "--nthreads", "--parsable", "--wrap", "--strict", "--part"}
    elsewhere |= {"--faults", "--changed"}  # of the script that plants faults
    elsewhere |= {"--once", "--stdin"}  # of ros2 topic pub
    assert {"--hand", "--transport", "--preset"} <= named and named - elsewhere <= known


def test_python_blocks_need_the_facade_alone():
    deep = re.compile(r"(?:from|import) (grasp_refine(?:_apps)?\.\S+)")
    assert not [module for block in blocks("python") for module in deep.findall(block)]
    used = {name for block in blocks("python") for name in re.findall(r"\bgr\.(\w+)", block)}
    assert len(used) > 30 and used <= set(dir(gr))


# figures


def numbers(text: str) -> set[str]:
    """Numbers in a text: those of links, of code and of exponents left out."""
    text = re.sub(r"\]\([^)]*\)|`[^`]*`|\[arXiv [\d.]+\]|10⁻|1e-\d", " ", text)
    return set(re.findall(r"(?<![\w.,])\d+(?:,\d{3})*(?:\.\d+)?", text))


def printed(name: str, text: str) -> str:
    """The figures that a run prints after a name, such as "0.482 → 0.000"."""
    (found,) = re.findall(rf"^{name}.*? ([\d.]+ → [\d.]+)(?: mm)?$", text, re.MULTILINE)
    return found


def rounded(figures: str) -> str:
    """Figures "a → b" to hundredths."""
    return " → ".join(f"{float(number):.2f}" for number in figures.split(" → "))


def test_figures_that_readme_shows_twice_are_equal():
    """Sample output, its own means, text, table, the same table on the benchmarks page, and both introductions."""
    readme, overview = PAGES["README.md"], PAGES["docs/pages/index.md"]
    (sample,) = (block for block in blocks("text", readme) if block.startswith("$ refine-grasp run\n"))
    (again,) = (block for block in blocks("text", PAGES["docs/pages/getting-started.md"]) if block == sample)
    lines = re.findall(r"^ {5}\d +([\d.]+) → ([\d.]+) +([\d.]+) → ([\d.]+)", sample, re.MULTILINE)
    errors, _, depths, _ = (np.array(column, dtype=float) for column in zip(*lines, strict=True))
    error, depth = printed("contact error fell", sample), printed("penetration fell", sample)
    residual = printed("wrench residual fell", sample)
    assert errors.mean() == pytest.approx(float(error.split()[0]), abs=0.006)
    assert depths.mean() == pytest.approx(float(depth.split()[0]), abs=0.006)
    (time,) = re.findall(r"iterations, ([\d.]+ m?s) / ", sample)
    held = "2 → 4 of 4 hold"
    assert f"here {held}" in readme
    for page, heading in (("README.md", MEASURED), ("docs/pages/benchmarks.md", "At a glance")):
        rows = {row.strip("| ").split(" | ")[0].lower(): row for row in section(page, heading).splitlines()}
        (means,) = (row for name, row in rows.items() if "mean before → after" in name)
        assert f"contact error {rounded(error)} mm, penetration {rounded(depth)} mm" in means
        assert "wrench" not in means or f"wrench residual {rounded(residual)}" in means
        (took,) = (row for name, row in rows.items() if "forces balanced" in name)
        assert f"| {time} (median)" in took
        (simulated,) = (row for name, row in rows.items() if name.startswith("the same in simulation"))
        assert held in simulated
    pictures = [re.findall(r"!\[(.*?)\]", page, re.DOTALL)[0].split() for page in (readme, overview)]
    assert pictures[0] == pictures[1]


def test_what_readme_measured_stands_on_the_benchmarks_page():
    rows = [row for row in section("README.md", MEASURED).splitlines() if row.startswith("| ")][1:]
    known = numbers(PAGES["docs/pages/benchmarks.md"])
    assert len(rows) >= 9
    assert {row.split(" | ")[0]: missing for row in rows if (missing := numbers(row) - known)} == {}
