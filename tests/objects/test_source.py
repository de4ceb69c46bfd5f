"""What an object's name means on the command line, and in a grasp file."""

from pathlib import Path

import pytest

from grasp_refine.core.errors import AssetError, MeshError
from grasp_refine.objects.source import check_object_name, chosen_object, is_known, named_object
from refusals import assert_names, refused

FILE = Path("grasps.npz")


@pytest.fixture
def mirror(shared_assets: Path, workplace: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The shared folder as a mirror of the assets, and an empty cache."""
    monkeypatch.setenv("GRASP_REFINE_ASSETS", str(shared_assets))
    return shared_assets


def silent(line: str) -> None:
    raise AssertionError(f"nothing should be fetched: {line}")


@pytest.mark.parametrize("name", ["mug", "box:1,2,3", "some/mesh.obj", "Mesh.STL"])
def test_what_is_no_asset_is_left_to_load_object(name: str, workplace: Path) -> None:
    assert chosen_object(name, silent).source == name


@pytest.mark.parametrize(("name", "meant"), [("ycb/011_bananna", "ycb_011_banana"), ("mugg", "mug"), ("Mug", "mug")])
def test_an_unknown_object_is_refused_with_the_one_that_may_be_meant(workplace: Path, name: str, meant: str) -> None:
    for function in (lambda: chosen_object(name, silent), lambda: check_object_name(name)):
        with refused(AssetError, f"'{name}'", f" {meant}?", " mug, bottle"):
            function()


def test_a_mesh_file_that_is_not_there_is_refused_before_anything_is_loaded(workplace: Path) -> None:
    with refused(MeshError, "cup.obj"):
        check_object_name("cup.obj")
    Path("cup.obj").touch()
    check_object_name("cup.obj")


def test_a_file_or_folder_wins_over_an_asset(workplace: Path) -> None:
    (workplace / "banana").mkdir()
    chosen = chosen_object("banana", silent)
    assert chosen.source == "banana" and chosen.asset is None


@pytest.mark.parametrize("name", ["ycb/011_banana", "ycb_011_banana", "011_banana", "objects/ycb_011_banana"])
def test_an_asset_is_fetched_and_said_once(name: str, mirror: Path) -> None:
    said: list[str] = []
    chosen = chosen_object(name, said.append)
    assert chosen.asset is not None and chosen.asset.name == "ycb_011_banana" and chosen.asset.scale > 0
    assert Path(chosen.source).read_bytes() == (mirror / "objects/ycb_011_banana.obj").read_bytes()
    (line,) = said
    assert_names(line, "objects/ycb_011_banana", "YCB")
    assert chosen_object(name, silent) == chosen
    with refused(AssetError, "`accept_license`"):
        chosen_object("acronym_mug_10f6e090", lambda line: None)


def test_a_grasp_file_names_embedded_objects_and_primitives() -> None:
    assert named_object("mug", None, FILE, silent).source == "mug"
    assert named_object("sphere:0.04", None, FILE, silent).source == "sphere:0.04"


def test_a_grasp_file_names_assets_in_full_only(mirror: Path) -> None:
    assert named_object("ycb_011_banana", None, FILE, lambda line: None).asset is not None
    embedded = "mug, bottle, rounded_box, bowl"
    with refused(AssetError, "grasps.npz", "'011_banana'", embedded, "`object='ycb_011_banana'`"):
        named_object("011_banana", None, FILE, silent)


@pytest.mark.parametrize("name", ["secret.obj", "x:y.obj", "box:1,2,3.obj"])
def test_a_grasp_file_never_names_a_path(workplace: Path, name: str) -> None:
    """A colon makes none a primitive."""
    (workplace / name).write_text("")
    with refused(AssetError, "grasps.npz", f"'{name}'"):
        named_object(name, None, FILE, silent)


def test_a_toml_file_names_meshes_beside_it(tmp_path: Path) -> None:
    listing = tmp_path / "objects.toml"
    listing.write_text('cup = "meshes/cup.obj"\npot = "mug"\n')
    assert named_object("cup", listing, FILE, silent).source == tmp_path / "meshes/cup.obj"
    assert named_object("pot", listing, FILE, silent).source == "mug"
    with refused(AssetError, "objects.toml", "'pan'", "cup, pot"):
        named_object("pan", listing, FILE, silent)


def test_what_needs_no_mesh_is_known() -> None:
    assert all(map(is_known, ("mug", "box:0.1,0.1,0.1", "ycb_011_banana")))
    assert not any(map(is_known, ("011_banana", "cup.obj", "box:1,2", "")))


@pytest.mark.parametrize("text", ["x = " + "[" * 5000, "x" + ".a" * 30000 + " = 1", "x = " + "9" * 5000])
def test_a_toml_file_that_takes_too_much_is_refused(tmp_path: Path, text: str) -> None:
    listing = tmp_path / "objects.toml"
    listing.write_text(text)
    with refused(AssetError, "objects.toml", "TOML"):
        named_object("cup", listing, FILE, silent)
    listing.write_text(f"cup = 0x{'f' * 9000}")
    with refused(AssetError, "cup", "thousands of digits"):
        named_object("cup", listing, FILE, silent)
