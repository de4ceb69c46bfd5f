"""Hands from anyone: their files name nothing that did not come with them."""

from __future__ import annotations

from pathlib import Path

import pytest
import trimesh
from grasp_refine.apps.viewer import hand_files, mesh_bounds
from grasp_refine.apps.viewer.unpacking import UploadError
from grasp_refine.apps.viewer.uploads import received
from uploaded import TIP, gripper, gripper_zip, opened_files, zipped

from grasp_refine.hand import load_hand

URDF, MESH = "gripper/urdf/gripper.urdf", "gripper/meshes/tip.stl"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """An empty folder; beside it and above lie meshes that an upload must not read."""
    for secret in (tmp_path / "secret.stl", tmp_path / "meshes/secret.stl"):
        secret.parent.mkdir(exist_ok=True)
        secret.write_bytes(TIP)
    (tmp_path / "secret.urdf").write_text(gripper())
    (tmp_path / "uploads/1").mkdir(parents=True)
    return tmp_path / "uploads/1"


def refused(content: bytes, folder: Path, name: str = "hand.zip") -> str:
    """What is said; nothing that is not in the folder was opened."""
    with opened_files() as opened, pytest.raises(UploadError) as raised:
        received(name, content, folder)
    outside = folder.parents[1]
    assert not [path for path in opened if str(outside) in path and str(folder) not in path]
    text = str(raised.value)
    assert text.startswith(f"{name}: ") and "\n" not in text and str(folder) not in text
    return text


def test_a_ros_package_is_a_hand(folder: Path):
    upload = received("gripper.zip", gripper_zip(), folder)
    assert (upload.kind, upload.source) == ("hand", folder / "gripper" / URDF)
    with opened_files() as opened:
        hand = load_hand(upload.source)
    assert hand.joint_names == ("left_hinge", "right_hinge")
    assert str(folder / "gripper" / MESH) in opened
    # A tip of 2 cm, 4 cm from its hinge.
    assert hand.links_by_name["left"].body.pieces[0].bounds[1] == pytest.approx([0.01, 0.01, 0.065])


def test_a_hand_at_the_top_of_a_zip_is_called_like_the_zip(folder: Path):
    files = {"hand.toml": "", "a.urdf": gripper("tip.stl"), "tip.stl": TIP}
    assert load_hand(received("my gripper.zip", zipped(files), folder).source).name == "my_gripper"


def test_a_hand_toml_says_which_urdf(folder: Path):
    toml = 'name = "pincers"\nurdf = "urdf/gripper.urdf"\n'
    content = gripper_zip(**{"gripper/hand.toml": toml, "gripper/urdf/other.urdf": "<robot/>"})
    upload = received("gripper.zip", content, folder)
    assert upload.source == folder / "gripper/gripper"
    assert load_hand(upload.source).name == "pincers"


@pytest.mark.parametrize(
    "mesh",
    [
        "../../../../secret.stl",
        "../../../../../secret.stl",
        "../meshes/../../../../secret.stl",
        "{root}/secret.stl",
        "file://{root}/secret.stl",
        "file://%2e%2e/%2e%2e/%2e%2e/%2e%2e/secret.stl",
        "file:///etc/passwd",
        "package://gripper/../../../secret.stl",
        "package:///{root}/secret.stl",
        "package://../../../secret.stl",
    ],
)
@pytest.mark.parametrize("shown", [False, True], ids=["collision", "visual"])
def test_meshes_outside_are_refused(mesh: str, shown: bool, folder: Path):
    mesh = mesh.format(root=folder.parents[1])
    urdf = gripper(visual=mesh) if shown else gripper(mesh)
    text = refused(gripper_zip(**{URDF: urdf}), folder)
    assert "in gripper.urdf lies outside of the upload; pack it" in text


@pytest.mark.parametrize("mesh", ["package://anything/secret.stl", "package://meshes/secret.stl"])
@pytest.mark.parametrize("shown", [False, True], ids=["collision", "visual"])
def test_packages_are_not_looked_for_above_the_upload(mesh: str, shown: bool, folder: Path):
    urdf = gripper(visual=mesh) if shown else gripper(mesh)
    assert "is not in the upload; pack the mesh, too" in refused(gripper_zip(**{URDF: urdf}), folder)


def test_nothing_is_fetched(folder: Path):
    text = refused(gripper_zip(**{URDF: gripper("http://there/tip.stl")}), folder)
    assert "mesh 'http://there/tip.stl' in gripper.urdf is an address, which is not fetched" in text


def test_a_mesh_that_only_shows_may_be_missing(folder: Path):
    upload = received("a.zip", gripper_zip(**{URDF: gripper(visual="package://gripper/nowhere.stl")}), folder)
    assert load_hand(upload.source).joint_names == ("left_hinge", "right_hinge")


@pytest.mark.parametrize("urdf", ["../../../secret.urdf", "{root}/secret.urdf"])
def test_a_hand_toml_names_no_urdf_outside(urdf: str, folder: Path):
    urdf = urdf.format(root=folder.parents[1])
    text = refused(zipped({"hand/hand.toml": f'urdf = "{urdf}"'}), folder)
    assert f"urdf = '{urdf}' in hand.toml lies outside of the upload" in text


def test_a_hand_toml_names_no_urdf_that_cannot_be(folder: Path):
    assert "which is not in it; pack it, too" in refused(zipped({"hand/hand.toml": f'urdf = "{"a/" * 3000}b"'}), folder)


def test_mjcf_is_not_read_from_uploads(folder: Path):
    """It can include any file, and sizes in it can fill the memory."""
    content = gripper_zip(**{"gripper/hand.toml": 'urdf = "urdf/gripper.urdf"\nmjcf = "hand.xml"'})
    assert "names an MJCF file, which is not read from uploads" in refused(content, folder)


def test_there_must_be_one_hand(folder: Path):
    two = gripper_zip(**{"gripper/urdf/b.urdf": gripper()})
    assert "must hold one .urdf file; it holds gripper/urdf/b.urdf, gripper/urdf/gripper.urdf" in refused(two, folder)


@pytest.mark.parametrize(
    ("files", "said"),
    [
        ({"a/hand.toml": "", "b/hand.toml": ""}, "must hold one hand.toml; it holds a/hand.toml, b/hand.toml"),
        ({"a/hand.toml": ""}, "hand.toml must name a URDF, or lie beside a single one; beside it: none"),
        ({"a/hand.toml": 'urdf = "b.urdf"'}, "names the URDF 'b.urdf', which is not in it"),
        ({"a/hand.toml": "urdf ="}, "hand.toml cannot be read as TOML"),
        ({"a/hand.toml": b"\xff"}, "hand.toml cannot be read as TOML"),
        ({"a/hand.toml": "a = " + "[" * 50_000}, "hand.toml cannot be read as TOML"),
        ({"a.urdf": "<robot"}, "a.urdf: is no XML"),
        ({"a.urdf": "<robot>" + '<link name="a"/>' * 257 + "</robot>"}, "a.urdf has 257 links, more than 256"),
    ],
)
def test_what_is_no_hand_is_refused(files: dict[str, bytes | str], said: str, folder: Path):
    assert said in refused(zipped(files, 0), folder)


LAUGHS = "".join(f'<!ENTITY l{i} "{f"&l{i - 1};" * 10 if i else "lol"}">' for i in range(12))


@pytest.mark.parametrize(
    "before",
    [
        f"<!DOCTYPE robot [{LAUGHS}]>",
        '<!DOCTYPE robot [<!ENTITY x SYSTEM "file:///etc/passwd">]>',
        '<!DOCTYPE robot SYSTEM "file:///etc/passwd">',
    ],
)
def test_declarations_in_a_urdf_are_refused(before: str, folder: Path):
    assert "declares a DOCTYPE" in refused(gripper_zip(**{URDF: gripper(before=before)}), folder)


def test_sizes_of_hands_are_bounded(folder: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(mesh_bounds, "MOST_FACES", 300)
    ball = trimesh.creation.icosphere(2, 0.03).export(file_type="stl")
    text = refused(gripper_zip(**{MESH: ball}), folder)
    assert "gripper/meshes/tip.stl: has up to 320 triangles, more than 300" in text


def test_all_meshes_of_a_hand_count_together(folder: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(mesh_bounds, "MOST_FACES", 20)
    other = {"gripper/meshes/b.stl": TIP, URDF: gripper(visual="../meshes/b.stl")}
    assert "hand.zip: has up to 24 triangles, more than 20" in refused(gripper_zip(**other), folder)


def test_a_urdf_of_bounded_size(folder: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(hand_files, "LARGEST_URDF", 512)
    assert "gripper.urdf has 0 KiB, more than 0 KiB" in refused(gripper_zip(), folder)


def test_a_urdf_of_shapes_needs_no_zip(folder: Path):
    urdf = gripper().replace('<mesh filename="package://gripper/meshes/tip.stl"/>', '<box size="0.02 0.02 0.05"/>')
    upload = received("gripper.urdf", urdf.encode(), folder)
    assert load_hand(upload.source).joint_names == ("left_hinge", "right_hinge")
