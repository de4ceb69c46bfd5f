"""Grasp files of others, as they were published: all are read, and fingertips are where they should be."""

import io
import zipfile
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.spatial import ConvexHull

from grasp_refine.core.errors import GraspFileError
from grasp_refine.core.se3 import inverse, transform_from_pose, transform_points
from grasp_refine.grasps.formats.agreement import fingertip_distances
from grasp_refine.grasps.formats.content import load_content
from grasp_refine.grasps.formats.format import Format
from grasp_refine.grasps.formats.listing import FORMATS
from grasp_refine.grasps.formats.reading import Reading, reading
from grasp_refine.grasps.grasp_set import GraspSet, load_grasps, match_joints, save_npz
from grasp_refine.hands.hand import Hand, load_hand
from grasp_refine.hands.kinematics import Kinematics
from refusals import assert_names, refused

Load = Callable[..., Hand]
ROUNDING = 1e-14
"""Metres; both sides are computed in double precision from the same numbers."""


@pytest.fixture
def published(shared_assets: Path) -> Path:
    return shared_assets / "grasps"


@pytest.fixture(scope="module")
def benched(shared_assets: Path) -> Reading:
    """All files of one folder for DexGraspBench."""
    heard: list[tuple[int, int]] = []
    read = reading(shared_assets / "grasps" / "bodex_shadow", on_file=lambda done, total: heard.append((done, total)))
    assert heard == [(number + 1, 240) for number in range(240)]
    return read


def test_every_published_file_is_read(benched: Reading, published: Path):
    counts: dict[tuple[str, str], list[int]] = {}
    counts["bodex_shadow", benched.format.name] = [1] * len(benched.files)
    assert len(benched.grasps) == len(benched.files)
    for folder in ("dexgraspnet_shadow", "dexonomy_shadow", "leap_cube_cache", "normalised"):
        for file in sorted((published / folder).rglob("*.np[yz]")):
            read = reading(file)
            counts.setdefault((folder, read.format.name), []).append(len(read.grasps))
    assert {key: (len(sizes), sum(sizes)) for key, sizes in counts.items()} == {
        ("bodex_shadow", "dexgraspbench"): (240, 240),
        ("dexgraspnet_shadow", "dexgraspnet"): (3, 657),
        ("dexonomy_shadow", "dexonomy"): (1, 1),
        ("leap_cube_cache", "leap_cache"): (1, 1024),
        ("normalised", "ours"): (4, 240 + 657 + 768 + 640),
    }


def test_dexgraspbench_files_agree_with_the_normalised_ones(benched: Reading, published: Path, load: Load):
    known = load_grasps(published / "normalised" / "bodex_shadow.npz")
    with np.load(published / "normalised" / "bodex_shadow.npz") as file:
        sources = [published / name for name in file["src_file"].tolist()]
    # The rows there are sorted by name, ours as people count.
    order = [benched.files.index(source) for source in sources]
    assert sorted(order) == list(range(240))
    read = benched.grasps.select(order)
    assert read.object.tolist() == known.object.tolist()
    np.testing.assert_allclose(read.scale, known.scale, rtol=1e-12)
    assert fingertip_distances(read, known, partial(load, "shadow")).max() < ROUNDING


def test_dexgraspnet_files_agree_with_the_normalised_ones(published: Path, load: Load):
    read = reading(published / "dexgraspnet_shadow").grasps
    known = load_grasps(published / "normalised" / "dexgraspnet_shadow.npz")
    assert read.object.tolist() == known.object.tolist()
    np.testing.assert_array_equal(read.scale, known.scale)
    assert fingertip_distances(read, known, partial(load, "shadow")).max() < ROUNDING


def test_the_leap_cache_agrees_with_the_normalised_one(published: Path, load: Load):
    read = reading(published / "leap_cube_cache").grasps
    known = load_grasps(published / "normalised" / "leap_cube.npz")
    # Every fourth grasp was left out there.
    read = read.select([row for row in range(1024) if row % 4 != 3])
    assert len(read) == len(known)
    assert fingertip_distances(read, known, partial(load, "leap")).max() < ROUNDING


def test_contacts_of_a_dexonomy_file_are_on_the_links_that_it_names(published: Path, shared_assets: Path):
    file = published / "dexonomy_shadow" / "grasp.npy"
    held = load_content(file)
    read = reading(file)
    assert read.grasps.object.tolist() == ["core_cellphone_34e36249166b8c6bc3f912172873d52f"]
    assert read.grasps.scale.tolist() == [0.11]
    assert len(read.notes) == 2
    assert_names(read.notes[1], "'core_cellphone_34e36249166b8c6bc3f912172873d52f'", "0.11")
    # With the maker's meshes, which the generator has, too.
    urdf = shared_assets / "hands" / "shadow" / "shadow_right.urdf"
    hand = load_hand("shadow", urdf=urdf, base_link="palm", candidates=16)
    links = [name.removeprefix("rh_") for name in held["hand_cbody"]]
    q, _ = match_joints(read.grasps, hand)
    T_object_root = torch.as_tensor(transform_from_pose(read.grasps.hand_pose))
    poses = Kinematics(hand, links)(T_object_root, torch.as_tensor(q)).numpy()[0]
    for link, T, point in zip(links, poses, held["hand_cpn_w"][:, :3].astype(float), strict=True):
        body = hand.links_by_name[link].body
        assert body is not None
        hull = ConvexHull(np.concatenate([piece.vertices for piece in body.pieces]))
        local = transform_points(inverse(T), point)
        depth = (hull.equations[:, :3] @ local + hull.equations[:, 3]).max()
        # Where the palm's offset from the frame of the file is forgotten, it is 15 to 34 mm.
        assert abs(depth) < 5e-4


def test_a_file_of_no_format_is_refused_with_a_reason_for_each(tmp_path: Path):
    np.save(tmp_path / "g.npy", np.array({"grasp_qpos": np.zeros(29)}, dtype=object))
    with refused(GraspFileError, tmp_path / "g.npy", *(f"{known.name}: " for known in FORMATS), "`format`") as caught:
        reading(tmp_path / "g.npy")
    assert_names(str(caught.value), ".npz", "obj_pose, obj_scale, obj_path", "robot_pose", "n_evo", "evolution_num")
    with refused(GraspFileError, tmp_path / "g.npy", "bodex", "robot_pose"):
        reading(tmp_path / "g.npy", format="bodex")
    with refused(GraspFileError, "'graspit'", ", ".join(known.name for known in FORMATS)):
        reading(tmp_path / "g.npy", format="graspit")


def test_a_file_of_two_formats_is_ambiguous(tmp_path: Path):
    held = dict.fromkeys(("grasp_qpos", "obj_pose", "obj_scale", "obj_path", "robot_pose"), 1.0)
    np.save(tmp_path / "g.npy", np.array(held, dtype=object))
    with refused(GraspFileError, tmp_path / "g.npy", "dexgraspbench", "bodex", "`format`") as caught:
        reading(tmp_path / "g.npy")
    assert "dexonomy" not in str(caught.value)


def test_folders_that_cannot_be_read(tmp_path: Path, grasps: Callable[..., GraspSet]):
    with refused(GraspFileError, tmp_path, ".npz, .npy, .pickle, .pkl"):
        reading(tmp_path)
    with refused(GraspFileError, tmp_path / "none.npy"):
        reading(tmp_path / "none.npy")
    rows = np.zeros((3, 23), dtype=np.float32)
    rows[:, 22] = 1
    np.save(tmp_path / "b_s10.npy", rows)
    save_npz(tmp_path / "a.npz", grasps("shadow").arrays())
    with refused(GraspFileError, tmp_path / "a.npz", "ours", tmp_path / "b_s10.npy", "leap_cache"):
        reading(tmp_path)
    (tmp_path / "b_s10.npy").unlink()
    save_npz(tmp_path / "b.npz", grasps("leap").arrays())
    with refused(GraspFileError, tmp_path / "b.npz", "'leap'", "'palm_lower'", tmp_path / "a.npz", "'shadow'"):
        reading(tmp_path)


def test_files_of_a_folder_are_one_set(tmp_path: Path, grasps: Callable[..., GraspSet], load: Load):
    whole = grasps("shadow")
    first, second = whole.select([0, 1]), whole.select([2, 3, 4])
    # The joints of the second in another order, and without a squeeze.
    order = list(range(22))[::-1]
    other = second.arrays()
    for key in ("q", "pregrasp_q"):
        other[key] = other[key][:, order]
    other["joint_names"] = other["joint_names"][order]
    del other["squeeze_pose"], other["squeeze_q"]
    save_npz(tmp_path / "2" / "a.npz", first.arrays())
    save_npz(tmp_path / "10" / "a.npz", other)
    read = reading(tmp_path)
    assert fingertip_distances(read.grasps, whole.select(range(5)), partial(load, "shadow")).max() < 1e-15
    assert read.grasps.object.tolist() == whole.object[:5].tolist()
    (note,) = read.notes
    assert_names(note, "squeeze")
    assert read.grasps.squeeze is None


@pytest.mark.parametrize("known", [*FORMATS], ids=lambda known: known.name)
def test_every_format_refuses_what_is_none(known: Format):
    stream = io.BytesIO()
    np.save(stream, np.zeros(3))
    for content in (3, "text", [], [1], {}, np.zeros(3), np.zeros((2, 23), dtype=int), {"qpos": 1}, [{"qpos": {}}]):
        assert known.mismatch(content)


def unidexgrasp(qpos: object, **entries: object) -> bytes:
    """A file of UniDexGrasp."""
    stream = io.BytesIO()
    np.savez(stream, qpos=np.array(qpos, dtype=object), **entries)
    return stream.getvalue()


def test_unidexgrasp_is_dexgraspnet_with_the_inverse_scale(published: Path, tmp_path: Path):
    """Its code takes 1 / scale for the size, and poses in the object's frame, whatever the table."""
    source = min((published / "dexgraspnet_shadow" / "dataset").glob("*.npy"))
    entries = np.load(source, allow_pickle=True).tolist()[:3]
    expected = reading(source).grasps.select([0, 1, 2])
    folder = tmp_path / source.stem
    folder.mkdir()
    for number, entry in enumerate(entries):
        inverse_scale, plane = np.float32(1.0 / entry["scale"]), np.array([0, 0.6, 0.8, 0.02], np.float32)
        file = folder / f"{number:05d}.npz"
        file.write_bytes(unidexgrasp(entry["qpos"], scale=inverse_scale, plane=plane))
    read = reading(folder)
    assert read.format.name == "unidexgrasp" and any("plane" in note for note in read.notes)
    np.testing.assert_array_equal(read.grasps.hand_pose, expected.hand_pose)
    np.testing.assert_array_equal(read.grasps.q, expected.q)
    np.testing.assert_allclose(read.grasps.scale, expected.scale, rtol=1e-6)
    assert read.grasps.object.tolist() == expected.object.tolist()


def test_code_in_an_npz_of_objects_is_refused_and_does_not_run(tmp_path: Path):
    file = tmp_path / "00000.npz"

    class Call:
        def __reduce__(self):
            return (Path.mkdir, (tmp_path / "made",))

    file.write_bytes(unidexgrasp({"WRJTx": Call()}, scale=12.5))
    with refused(GraspFileError, file, "refused"):
        reading(file)
    assert not (tmp_path / "made").exists()


def test_an_npz_of_objects_that_would_fill_the_memory_is_refused(tmp_path: Path):
    file = tmp_path / "00000.npz"
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("qpos.npy", content_of({"WRJTx": "x" * 2**25}))
        archive.writestr("scale.npy", content_of(12.5))
    with refused(GraspFileError, file, "unpack"):
        reading(file)


def content_of(value: object) -> bytes:
    """An array file of one object."""
    stream = io.BytesIO()
    np.save(stream, np.array(value, dtype=object))
    return stream.getvalue()


@pytest.mark.parametrize("ending", [".npy", ".npz", ".h5", ".pt", ".json"])
def test_a_pointer_of_git_lfs_is_named(tmp_path: Path, ending: str):
    file = tmp_path / f"grasps{ending}"
    file.write_text(f"version https://git-lfs.github.com/spec/v1\noid sha256:{'0' * 64}\nsize 7293684\n")
    with refused(GraspFileError, file, "git lfs pull"):
        reading(file)
