"""Job lists: what folders, patterns, TOML and CSV files mean, and how what is wrong in them is told."""

from pathlib import Path

import pytest

from grasp_refine.core.errors import GraspRefineError
from grasp_refine_apps.batch.jobs import Job, read_jobs
from grasp_refine_apps.commands.inputs import Inputs
from refusals import refused


def jobs(*sources: object, **defaults: object) -> list[Job]:
    return read_jobs([str(source) for source in sources], Inputs(**defaults))


def assert_problem(source: object, *named: object) -> None:
    """Jobs of a source are refused with a message that names these."""
    with refused(GraspRefineError, *named):
        jobs(source)


def listed(folder: Path, text: str, name: str = "jobs.toml") -> Path:
    path = folder / name
    path.write_text(text)
    return path


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Grasp files in a folder and below it, and other files."""
    for name in ("b10.npz", "b9.npz", "deep/b9.npy", "deep/er/c.pickle", "notes.txt", "deep/.1.partial.x.npz"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).touch()
    return tmp_path


def test_a_folder_has_a_job_for_each_grasp_file_below_it_in_natural_order(folder: Path):
    assert [job.name for job in jobs(folder)] == ["b9", "b10", "deep/b9", "deep/er/c"]
    assert [job.inputs.grasps for job in jobs(folder)][2] == folder / "deep/b9.npy"


def test_a_pattern_has_a_job_for_each_match(folder: Path):
    assert [job.name for job in jobs(f"{folder}/*.npz")] == ["b9", "b10"]
    assert [job.name for job in jobs(f"{folder}/**/*.n*")] == ["b9", "b10", "deep/b9"]
    assert [job.name for job in jobs(f"{folder}/d*p")] == ["deep/b9", "deep/er/c"]


def test_sources_are_joined_and_equal_names_are_distinguished(folder: Path):
    assert [job.name for job in jobs(folder / "b9.npz", folder / "deep", "sample:5")] == [
        "b9",
        "b9_2",
        "er/c",
        "sample_5",
    ]


def test_what_is_named_twice_counts_once(folder: Path):
    assert [job.name for job in jobs(folder / "b9.npz", folder, f"{folder}/*.npz")] == [
        "b9",
        "b10",
        "deep/b9",
        "deep/er/c",
    ]


def test_folders_behind_links_are_looked_into_once(folder: Path, tmp_path_factory: pytest.TempPathFactory):
    other = tmp_path_factory.mktemp("other")
    (other / "far.npz").touch()
    (other / "back").symlink_to(folder)
    (folder / "link").symlink_to(other)
    assert [job.name for job in jobs(folder)] == ["b9", "b10", "deep/b9", "deep/er/c", "link/far"]


def test_names_win_over_folders_beside_the_list(folder: Path):
    for name in ("allegro", "mug", "palm"):
        (folder / name).mkdir()
    text = '[[job]]\ngrasps = "b9.npz"\nhand = "allegro"\nobject_name = "mug"\nbase_link = "palm"\n'
    (job,) = jobs(listed(folder, text))
    assert (job.inputs.hand, job.inputs.object_name, job.inputs.base_link) == ("allegro", "mug", "palm")
    (job,) = jobs(listed(folder, '[[job]]\ngrasps = "b9.npz"\nhand = "./allegro"\n'))
    assert job.inputs.hand == str(folder / "allegro")


def test_only_files_that_were_named_are_named(folder: Path):
    assert [job.named for job in jobs(folder / "b9.npz", folder / "deep")] == [True, False, False]


def test_options_are_defaults_of_every_job(folder: Path):
    found = jobs(folder / "b9.npz", hand="allegro", scale=2.0)
    assert found[0].inputs == Inputs(grasps=folder / "b9.npz", hand="allegro", scale=2.0)


def test_a_toml_list_has_defaults_and_jobs_with_paths_relative_to_it(folder: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir("/")
    (folder / "meshes").mkdir()
    (folder / "cup.obj").touch()
    path = listed(
        folder,
        """
        [defaults]
        hand = "leap"
        scale = 2
        [[job]]
        grasps = "b9.npz"
        objects = "meshes"
        [[job]]
        name = "all"
        grasps = "deep"
        hand = "allegro"
        object = "cup.obj"
        holes = "cap"
        [[job]]
        grasps = "sample:8"
        object = "mug"
        """,
    )
    found = jobs(path)
    assert [job.name for job in found] == ["b9", "all/b9", "all/er/c", "sample_8"]
    assert found[0].inputs == Inputs(grasps=folder / "b9.npz", hand="leap", scale=2.0, objects=folder / "meshes")
    assert found[1].inputs == Inputs(
        grasps=folder / "deep/b9.npy", hand="allegro", scale=2.0, object=str(folder / "cup.obj"), holes="cap"
    )
    assert found[3].inputs == Inputs(grasps=Path("sample:8"), hand="leap", scale=2.0, object="mug")


def test_a_csv_list_has_a_job_in_each_line_and_empty_cells_are_left_to_the_options(folder: Path):
    path = listed(folder, "name,grasps,hand,scale\nfirst,b9.npz,leap,0.1\n,*.npz,,\n", "jobs.csv")
    found = jobs(path, hand="allegro")
    assert [job.name for job in found] == ["first", "b9", "b10"]
    assert found[0].inputs == Inputs(grasps=folder / "b9.npz", hand="leap", scale=0.1)
    assert found[1].inputs == Inputs(grasps=folder / "b9.npz", hand="allegro")


def test_a_list_may_say_yes_and_no(folder: Path):
    """The text 'false' once counted as yes: results of another object were taken."""
    table = "[[job]]\ngrasps = 'b9.npz'\nother_object = true\n[[job]]\ngrasps = 'b10.npz'\nother_object = 'false'"
    assert [job.inputs.other_object for job in jobs(listed(folder, table))] == [True, False]
    cells = listed(folder, "grasps,other_object\nb9.npz,True\nb10.npz,false\n", "jobs.csv")
    assert [job.inputs.other_object for job in jobs(cells)] == [True, False]


def test_relative_paths_no_longer_depend_on_the_working_folder(folder: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(folder)
    (found,) = jobs("b9.npz", hand="deep/hand.urdf", objects=Path("deep"))
    assert found.inputs.grasps == folder / "b9.npz"
    assert found.inputs.objects == folder / "deep"
    # Not there: what is wrong with it is told with the job.
    assert found.inputs.hand == "deep/hand.urdf"


def test_a_file_that_is_not_there_is_a_job_that_will_be_reported(tmp_path: Path):
    assert [job.name for job in jobs(tmp_path / "none.npz")] == ["none"]


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("", ("jobs.toml",)),
        ("job = 3", ("jobs.toml", "[[job]]")),
        ("[[job]]\ngrasp = 'x.npz'", ("job 1", "'grasp'", "there are name, task, protocol")),
        ("[[job]]\nhand = 'leap'", ("job 1", 'grasps = "FILE"')),
        ("[[job]]\ngrasps = 'b9.npz'\nscale = 'big'", ("job 1", "scale", "'big'")),
        ("[[job]]\ngrasps = 'b9.npz'\nother_object = 1", ("job 1", "other_object", "true or false", "1")),
        ("[[job]]\ngrasps = 'b9.npz'\nunit = 'miles'", ("job 1", "unit", "m, cm, mm, in", "'miles'")),
        ("[[job]]\ngrasps = '*.nothing'", ("*.nothing",)),
        ("[defaults]\nindex = [1]\n[[job]]", ("[defaults]", "'index'")),
        ("[[job]", ("jobs.toml", "TOML")),
        ("[defaults]\nname = 'x'\n[[job]]\ngrasps = 'b9.npz'", ("[defaults]", "name")),
        ("x = " + "[" * 5000, ("jobs.toml", "TOML", "nested")),
        ("x = " + "9" * 5000, ("jobs.toml", "TOML", "Exceeds the limit")),
        (f"[[job]]\ngrasps = 'b9.npz'\nscale = {10**400}", ("job 1", "scale", " 1000")),
        (f"[[job]]\ngrasps = 0x{'f' * 9000}", ("job 1", "grasps", "thousands of digits")),
        ("[[job]]\ngrasps = 'b9.npz'\nname = '//'", ("'//'",)),
        ('[[job]]\ngrasps = "b9.npz"\nname = "a\\nb"', ("'a\\nb'",)),
        ('[[job]]\ngrasps = "\\u0000*.npz"', ("job 1", "grasps", "control characters", "\\x00*.npz")),
    ],
)
def test_what_is_wrong_in_a_toml_list_is_reported_with_its_place(folder: Path, text: str, named: tuple[str, ...]):
    assert_problem(listed(folder, text), *named)


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("grasps\n", ("jobs.csv",)),
        ("grasps,colour\nb9.npz,red\n", ("header", "'colour'")),
        ("grasps,hand\nb9.npz\n", ("job 1", "header, 2")),
        ("grasps,scale\nb9.npz,nan\n", ("job 1", "scale", "'nan'")),
        ("hand\nleap\n", ("job 1", "grasps")),
        ('grasps\n"b9.npz\n', ("jobs.csv", "CSV")),
    ],
)
def test_what_is_wrong_in_a_csv_list_is_reported_with_its_place(folder: Path, text: str, named: tuple[str, ...]):
    assert_problem(listed(folder, text, "jobs.csv"), *named)


@pytest.mark.parametrize("name", ["a" * 300, "a/" * 3000, "~nobody-is-called-so/x"])
def test_what_cannot_be_a_path_is_a_job_that_will_be_reported(folder: Path, name: str):
    """Python raises at the length of the first two, and at the home of the third."""
    (job,) = jobs(listed(folder, f'[[job]]\nname = "x"\ngrasps = "{name}"\nobject = "{name}.obj"'))
    assert str(job.inputs.grasps) == str(Path(name))


def test_a_file_with_a_name_that_is_no_text_is_a_job_that_will_be_reported(tmp_path: Path):
    try:
        (tmp_path / "a\udcffb.npz").touch()
    except OSError:
        pytest.skip("this file system has no such names")
    assert [job.name for job in jobs(tmp_path)] == ["a\udcffb"]
