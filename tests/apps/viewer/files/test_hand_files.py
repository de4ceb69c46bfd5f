"""Hands from anyone: their files name nothing that did not come with them."""

from pathlib import Path

import pytest

from grasp_refine.hands.hand import load_hand
from grasp_refine_apps.viewer.files import hand_files
from grasp_refine_apps.viewer.files.unpacking import UploadError
from grasp_refine_apps.viewer.files.uploads import store_upload
from refusals import assert_names
from uploaded import TIP, gripper, gripper_zip, opened_files, zipped

pytestmark = pytest.mark.usefixtures("untried")

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
        store_upload(name, content, folder)
    outside = folder.parents[1]
    assert not [path for path in opened if str(outside) in path and str(folder) not in path]
    text = str(raised.value)
    assert text.startswith(f"{name}: ") and "\n" not in text and str(folder) not in text
    return text


def test_a_ros_package_is_a_hand(folder: Path):
    upload = store_upload("gripper.zip", gripper_zip(), folder)
    assert (upload.kind, upload.source) == ("hand", folder / "gripper" / URDF)
    with opened_files() as opened:
        hand = load_hand(upload.source)
    assert hand.joint_names == ("left_hinge", "right_hinge")
    assert str(folder / "gripper" / MESH) in opened
    # A tip of 2 cm, 4 cm from its hinge.
    assert hand.links_by_name["left"].body.pieces[0].bounds[1] == pytest.approx([0.01, 0.01, 0.065])


def test_a_hand_at_the_top_of_a_zip_is_called_like_the_zip(folder: Path):
    files = {"hand.toml": "", "a.urdf": gripper("tip.stl"), "tip.stl": TIP}
    assert load_hand(store_upload("my gripper.zip", zipped(files), folder).source).name == "my_gripper"


def test_a_hand_toml_says_which_urdf(folder: Path):
    toml = 'name = "pincers"\nurdf = "urdf/gripper.urdf"\n'
    content = gripper_zip(**{"gripper/hand.toml": toml, "gripper/urdf/other.urdf": "<robot/>"})
    upload = store_upload("gripper.zip", content, folder)
    assert upload.source == folder / "gripper/gripper"
    assert load_hand(upload.source).name == "pincers"


@pytest.mark.parametrize(
    "mesh",
    [
        "package://anything/secret.stl",
        "package://meshes/secret.stl",
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
    # Packages are not looked for above the upload.
    named = () if mesh.endswith(("anything/secret.stl", "//meshes/secret.stl")) else ("outside",)
    assert_names(refused(gripper_zip(**{URDF: urdf}), folder), mesh, "gripper.urdf", *named)


def test_nothing_is_fetched(folder: Path):
    text = refused(gripper_zip(**{URDF: gripper("http://there/tip.stl")}), folder)
    assert_names(text, "'http://there/tip.stl'", "gripper.urdf")


@pytest.mark.parametrize("urdf", ["../../../secret.urdf", "{root}/secret.urdf"])
def test_a_hand_toml_names_no_urdf_outside(urdf: str, folder: Path):
    urdf = urdf.format(root=folder.parents[1])
    text = refused(zipped({"hand/hand.toml": f'urdf = "{urdf}"'}), folder)
    assert_names(text, f"urdf = '{urdf}'", "hand.toml", "outside")


MJCF = """<mujoco model="pincers">{head}<compiler meshdir="../meshes"/>
  <asset><mesh name="tip" file="tip.stl"/></asset><worldbody>{include}</worldbody></mujoco>"""

MJCF_BODY = """<mujocoinclude><body name="palm"><geom size="0.02"/>
  <body name="left" pos="0.02 0 0"><joint name="left" axis="0 1 0" range="-1 1"/><geom type="mesh" mesh="tip"/></body>
  <body name="right" pos="-0.02 0 0"><joint name="right" axis="0 1 0"/><geom type="mesh" mesh="tip"/></body>
</body></mujocoinclude>"""


def mjcf_zip(head: str = "", include: str = '<include file="fingers.xml"/>', **more: bytes | str) -> bytes:
    """A zip of a hand as an MJCF that includes its fingers."""
    main = MJCF.format(head=head, include=include)
    return zipped({"g/xml/hand.xml": main, "g/xml/fingers.xml": MJCF_BODY, "g/meshes/tip.stl": TIP, **more})


def test_an_mjcf_with_what_it_includes_is_a_hand(folder: Path):
    upload = store_upload("g.zip", mjcf_zip(), folder)
    assert (upload.kind, upload.source) == ("hand", folder / "g/g/xml/hand.xml")
    with opened_files() as opened:
        hand = load_hand(upload.source, candidates=16)
    assert hand.joint_names == ("left", "right") and not [path for path in opened if "secret" in path]
    # So it is where a hand.toml names it.
    (folder / "2").mkdir()
    content = mjcf_zip(**{"g/hand.toml": 'mjcf = "xml/hand.xml"\nname = "mine"'})
    assert load_hand(store_upload("g.zip", content, folder / "2").source, candidates=16).name == "mine"


@pytest.mark.parametrize(
    ("head", "named"),
    [
        ('<include file="../../../../secret.xml"/>', ("secret.xml", "outside")),
        ('<include file="{root}/secret.xml"/>', ("secret.xml", "outside")),
        ('<asset><mesh file="../../../../secret.stl"/></asset>', ("secret.stl", "outside")),
        ('<asset><mesh file="{root}/secret.stl"/></asset>', ("secret.stl", "outside")),
        ('<asset><mesh file="secret.stl"/></asset><compiler assetdir="../../../.."/>', ("secret.stl", "outside")),
        ('<asset><model name="m" file="fingers.xml"/></asset>', ("<model>",)),
        ("<worldbody>" + 257 * "<body/>" + "</worldbody>", ("257 bodies", "256")),
    ],
)
def test_an_mjcf_names_nothing_outside(head: str, named: tuple[str, ...], folder: Path):
    (folder.parents[1] / "secret.xml").write_text(MJCF_BODY)
    assert_names(refused(mjcf_zip(head.format(root=folder.parents[1])), folder), *named)


def test_an_mjcf_is_in_the_encoding_in_which_it_is_checked(folder: Path):
    """A name that is text in one encoding is an element in another."""
    content = zipped({"hand.xml": '<?xml version="1.0" encoding="ISO-2022-JP"?>' + MJCF.format(head="", include="")})
    assert_names(refused(content, folder), "hand.xml", "UTF-8")


@pytest.mark.parametrize(
    ("files", "named"),
    [
        ({"a/hand.toml": "", "b/hand.toml": ""}, ("a/hand.toml", "b/hand.toml")),
        ({"a.urdf": gripper(), "b.urdf": gripper()}, (".urdf", "a.urdf, b.urdf")),
        ({"a/hand.toml": ""}, ("hand.toml", "URDF", "none")),
        ({"a/hand.toml": 'urdf = "b.urdf"'}, ("URDF", "'b.urdf'")),
        ({"a/hand.toml": f'urdf = "{"a/" * 3000}b"'}, ("URDF", "'b'")),
        ({"a/hand.toml": "urdf ="}, ("hand.toml", "TOML")),
        ({"a/hand.toml": b"\xff"}, ("hand.toml", "TOML")),
        ({"a/hand.toml": "a = " + "[" * 50_000}, ("hand.toml", "TOML")),
        ({"a.urdf": "<robot"}, ("a.urdf", "XML")),
        ({"a.urdf": "<robot>" + '<link name="a"/>' * 257 + "</robot>"}, ("a.urdf", "257 links", "256")),
    ],
)
def test_what_is_no_hand_is_refused(files: dict[str, bytes | str], named: tuple[str, ...], folder: Path):
    assert_names(refused(zipped(files, 0), folder), *named)


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
    assert_names(refused(gripper_zip(**{URDF: gripper(before=before)}), folder), "gripper.urdf", "DOCTYPE")


def test_a_urdf_of_bounded_size(folder: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(hand_files, "MAX_URDF_BYTES", 512)
    assert_names(refused(gripper_zip(), folder), "gripper.urdf", "0 KiB")
