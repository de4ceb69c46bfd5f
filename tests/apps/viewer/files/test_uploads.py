"""Uploads: what they are taken for, where they lie, and what is refused; no browser names a place on the disk."""

import gc
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
import trimesh

from grasp_refine.objects.object import load_object
from grasp_refine_apps.viewer.files import uploads
from grasp_refine_apps.viewer.files.unpacking import UploadError
from grasp_refine_apps.viewer.files.uploads import Uploads, shown_name, store_upload
from refusals import assert_names, refused
from uploaded import TIP, gripper_zip, opened_files, zipped

BALL = trimesh.creation.icosphere(2, 0.03)
OBJ = BALL.export(file_type="obj").encode()


def npz(folder: Path) -> bytes:
    """Something that looks like a grasp file."""
    np.savez(folder / "some.npz", q=np.zeros(3))
    content = (folder / "some.npz").read_bytes()
    (folder / "some.npz").unlink()
    return content


@pytest.mark.usefixtures("untried")
def test_meshes_of_all_formats_and_zips_are_what_is_in_them(tmp_path: Path):
    for ending in ("obj", "stl", "ply", "glb", "off"):
        content = BALL.export(file_type=ending)
        content = content.encode() if isinstance(content, str) else content
        name = f"Ball.{ending.upper()}"
        upload = store_upload(name, content, tmp_path)
        assert (upload.kind, upload.source, upload.name) == ("mesh", tmp_path / f"Ball.{ending}", name)
        obj = load_object(upload.source, cache=None)
        assert obj.convex and len(obj.mesh.faces) == len(BALL.faces)
    kinds = {}
    for name, content in {
        "hand": gripper_zip(),
        "grasps": zipped({"a/0.npy": b"x", "a/1.npy": b"x", "readme.txt": b""}),
        "one": zipped({"a/grasps.npz": npz(tmp_path)}),
        "mesh": zipped({"ball/ball.obj": OBJ, "ball/ball.mtl": b"newmtl a", "ball/texture.png": b"\x89PNG"}),
    }.items():
        (tmp_path / name).mkdir()
        upload = store_upload(f"{name}.zip", content, tmp_path / name)
        kinds[name] = (upload.kind, upload.source.relative_to(tmp_path).as_posix())
    assert kinds == {
        "hand": ("hand", "hand/hand/gripper/urdf/gripper.urdf"),
        "grasps": ("grasps", "grasps/grasps"),
        "one": ("grasps", "one/one/a/grasps.npz"),
        "mesh": ("mesh", "mesh/mesh/ball/ball.obj"),
    }


@pytest.mark.usefixtures("untried")
def test_grasps_beside_a_hand_are_reported(tmp_path: Path):
    upload = store_upload("hand.zip", gripper_zip(**{"gripper/a.npz": "x"}), tmp_path)
    assert upload.kind == "hand"
    (note,) = upload.notes
    assert_names(note, "1 grasp", "hand.zip")


@pytest.mark.parametrize(
    ("name", "content", "named"),
    [
        ("a.exe", b"MZ", (".obj, .stl",)),
        ("noending", b"x", (".obj, .stl",)),
        ("a.gltf", b"{}", (".obj, .stl",)),
        ("a.obj", b"", ("empty",)),
        ("a.zip", OBJ, ("suffix .zip",)),
        ("a.npz", OBJ, ("suffix .npz",)),
        ("a.obj", zipped({"a.obj": OBJ}), ("suffix .obj",)),
        ("a.npy", zipped({"a.npy": b"x"}), ("suffix .npy",)),
        ("a.zip", zipped({"a.txt": b"x"}), (".urdf", "hand.toml", ".npz")),
        ("a.zip", zipped({}), (".urdf", "hand.toml", ".npz")),
        ("a.zip", zipped({"a.obj": OBJ, "b/c.stl": TIP}), ("a.obj, b/c.stl", ".urdf", "hand.toml", ".npz")),
    ],
)
def test_what_is_refused_says_what_can_be_uploaded(name: str, content: bytes, named: tuple[str, ...], tmp_path: Path):
    with refused(UploadError, name, *named) as raised:
        store_upload(name, content, tmp_path)
    assert str(tmp_path) not in str(raised.value)


@pytest.mark.parametrize(
    ("name", "shown", "on_disk"),
    [
        ("../../etc/cron.d/evil.npy", "evil.npy", "evil.npy"),
        ("C:\\Users\\me\\my mug.npy", "my mug.npy", "my_mug.npy"),
        ("..npy", "..npy", "upload.npy"),
        (".npy", ".npy", None),
        ("a\0b\n\x1b[31m.npy", "a?b??[31m.npy", "a_b_31m.npy"),
        ("ä" * 300 + ".NPY", "ä" * 100 + ".NPY", "ä" * 100 + ".npy"),
        ("-rf $(reboot);.npy", "-rf $(reboot);.npy", "rf_reboot.npy"),
        ("Ka\u0308nnchen.npy", "Ka\u0308nnchen.npy", "Kännchen.npy"),
        ("茶碗 1.npy", "茶碗 1.npy", "茶碗_1.npy"),
        ("茶" * 100 + ".npy", "茶" * 100 + ".npy", "茶" * 66 + ".npy"),
    ],
)
def test_names_say_nothing_of_where_a_file_lies(name: str, shown: str, on_disk: str | None, tmp_path: Path):
    assert shown_name(name) == shown
    folder = tmp_path / "in"
    folder.mkdir()
    if on_disk is None:
        with refused(UploadError):
            store_upload(name, b"x", folder)
        assert not list(folder.iterdir())
        return
    upload = store_upload(name, b"x", folder)
    assert upload.source == folder / on_disk and [*tmp_path.rglob("*")] == [folder, upload.source]


def test_sizes_are_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(uploads, "MAX_UPLOAD_BYTES", len(OBJ))
    store_upload("a.npy", OBJ, tmp_path)
    with refused(UploadError, "b.npy", "0 MiB", "refine-grasp view --help"):
        store_upload("b.npy", OBJ + b"x", tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["a.npy"]


def test_a_session_has_a_limit_and_leaves_nothing(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(uploads, "MAX_SESSION_BYTES", 3 * len(OBJ))
    with closing(Uploads()) as session:
        assert session.path.stat().st_mode & 0o077 == 0
        first, second = session.receive("a.npy", OBJ), session.receive("a.npy", OBJ)
        assert first.folder != second.folder and first.source.read_bytes() == second.source.read_bytes()
        # One that is refused takes no room.
        with refused(UploadError, "b.zip", "damaged"):
            session.receive("b.zip", b"PK\x03\x04")
        assert len(list(session.path.iterdir())) == 2
        session.receive("c.npy", OBJ)
        with refused(UploadError, "d.npy", "0 MiB"):
            session.receive("d.npy", b"x")
    assert not session.path.exists()


def test_a_session_that_nobody_closes_leaves_nothing_either():
    session = Uploads()
    path = session.receive("a.npy", OBJ).source
    assert path.exists()
    del session
    gc.collect()
    assert not path.exists()


@pytest.mark.usefixtures("untried")
def test_a_mesh_reads_no_other_file(tmp_path: Path):
    """Materials and textures are names of files, which anyone can choose."""
    (tmp_path / "in").mkdir()
    secrets = {"secret.mtl": b"newmtl a\nmap_Kd secret.png", "secret.png": b"\x89PNG"}
    for folder in (tmp_path, tmp_path / "in"):
        for name, content in secrets.items():
            (folder / name).write_bytes(content)
    named = ("../secret", str(tmp_path / "secret"), "secret", "file://secret")
    ply = BALL.export(file_type="ply", encoding="ascii").decode()
    with opened_files() as opened:
        for at, name in enumerate(named):
            content = f"mtllib {name}.mtl\nusemtl a\n".encode() + OBJ
            load_object(store_upload(f"a{at}.obj", content, tmp_path / "in").source, cache=None)
            comment = ply.replace("end_header", f"comment TextureFile {name}.png\nend_header", 1)
            load_object(store_upload(f"a{at}.ply", comment.encode(), tmp_path / "in").source, cache=None)
    outside = [path for path in opened if path.startswith(str(tmp_path)) and Path(path).parent != tmp_path / "in"]
    assert not outside
    assert not [path for path in opened if path.endswith(".mtl")]
