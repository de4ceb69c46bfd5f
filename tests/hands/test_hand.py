"""Hands: ours as they load, five others, mimic joints, subtrees, and hand.toml."""

from pathlib import Path

import numpy as np
import pytest

from grasp_refine.assets.embedded import resource_dir
from grasp_refine.core.errors import AssetError, HandError
from grasp_refine.hands.hand import Contact, Coupled, Hand, load_hand, needs_urdf
from made_hands import BALL, link, write_urdf
from refusals import assert_names, refused

FINGERTIPS = {
    "allegro": ["link_3.0_tip", "link_7.0_tip", "link_11.0_tip", "link_15.0_tip"],
    "leap": ["fingertip", "fingertip_2", "fingertip_3", "thumb_fingertip"],
    "shadow": ["ffdistal", "mfdistal", "rfdistal", "lfdistal", "thdistal"],
    "barrett": ["finger_1_dist_link", "finger_2_dist_link", "finger_3_dist_link"],
    "robotiq3f": ["finger_1_link_3", "finger_2_link_3", "finger_middle_link_3"],
}
"""Contact links of the hands in the shared assets, as its README lists them."""

ALONG = {"allegro": ["link_3.0", "link_7.0", "link_11.0", "link_15.0"]}
"""Other links of their last rigid parts."""

JOINTS = {"allegro": 16, "leap": 16, "shadow": 24, "barrett": 8, "robotiq3f": 11}
"""Independent joints of each; Shadow's bare URDF begins at the palm, without the two of the wrist."""

FINGERS = {
    "leap": ["fingertip", "fingertip_2", "fingertip_3", "thumb"],
    "shadow": ["index", "middle", "ring", "little", "thumb"],
    "robotiq3f": ["finger_1_link_3", "finger_2_link_3", "middle"],
}
"""Groups of the contact links where names tell the finger."""


def joint(name: str, parent: str, child: str, kind: str = "revolute", inside: str = "") -> str:
    inside += '<limit lower="-1" upper="2" effort="3"/>'
    return f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>{inside}</joint>'


def write(folder: Path, links: dict[str, str], *joints: str, toml: str | None = None) -> Path:
    return write_urdf(folder, *(link(name, inside) for name, inside in links.items()), *joints, toml=toml)


def finger(folder: Path, toml: str | None = None) -> Path:
    """A palm on a wrist, with a finger of joints 1, 2 and a frame at its end; returns the URDF file."""
    links = {"arm": "", "palm": BALL, "near": BALL, "tip": BALL, "frame": ""}
    chain = [joint("wrist", "arm", "palm"), joint("1", "palm", "near"), joint("2", "near", "tip")]
    return write(folder, links, *chain, joint("end", "tip", "frame", "fixed"), toml=toml)


def test_allegro_touches_with_round_fingertips_of_the_published_size(shared_assets: Path) -> None:
    hand, other = load_hand("allegro"), load_hand(shared_assets / "hands/allegro")
    assert [(c.link, c.group) for c in hand.contacts] == list(
        zip(FINGERTIPS["allegro"], ["index", "middle", "ring", "thumb"], strict=True)
    )
    assert hand.notes == () and hand.name == "allegro" and hand.joint_names == other.joint_names
    for contact in hand.contacts:
        body = hand.links_by_name[contact.link].body
        ball = next(piece for piece in body.pieces if piece.radius > 0)
        np.testing.assert_allclose(contact.point, ball.vertices[0] + ball.radius * np.array(contact.normal), atol=1e-6)
        assert contact.normal[0] > 0.5, "the pad looks the way that the finger closes"
        # How far each of the two reaches in any direction.
        theirs = other.links_by_name[contact.link].body.pieces[0].vertices
        directions = np.random.default_rng(0).normal(size=(500, 3))
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        ours = np.max([(directions @ piece.vertices.T).max(1) + piece.radius for piece in body.pieces], axis=0)
        difference = np.abs(ours - (directions @ theirs.T).max(1))
        assert difference[directions[:, 2] > 0].max() < 1e-4 and difference.max() < 1e-3
    np.testing.assert_array_equal(hand.actuator.kp, 5.0)
    np.testing.assert_array_equal(hand.actuator.damping, 0.1)
    np.testing.assert_array_equal(hand.actuator.force_limit, 10.0)
    assert ((hand.lower < hand.rest) & (hand.rest < hand.upper)).all()


def test_allegro_collides_where_the_published_boxes_are(shared_assets: Path) -> None:
    hand, other = load_hand("allegro"), load_hand(shared_assets / "hands/allegro")
    for part in hand.links:
        if part.name not in FINGERTIPS["allegro"] and part.body is not None:
            for ours, theirs in zip(part.body.pieces, other.links_by_name[part.name].body.pieces, strict=True):
                np.testing.assert_allclose(ours.bounds, theirs.bounds, atol=1e-12)


def theirs(name: str, shared_assets: Path, **options) -> Hand:
    (urdf,) = (shared_assets / "hands" / name).glob("*.urdf")
    return load_hand(name, urdf=urdf, candidates=16, hull_limit=np.inf, **options)


def test_shadow_couples_its_outer_joints_wherever_it_begins(shared_assets: Path) -> None:
    for base_link in (None, "palm", "world"):
        hand = theirs("shadow", shared_assets, base_link=base_link)
        assert hand.base_link == (base_link or "forearm")
        assert hand.coupled == tuple(Coupled((f"{f}J2", f"{f}J1"), (1.0, 1.0)) for f in ("FF", "MF", "RF", "LF"))
        wrist = {"WRJ1", "WRJ2"} & set(hand.joint_names)
        assert len(wrist) == (0 if base_link == "palm" else 2)
        assert all(hand.actuator.damping[hand.joint_names.index(name)] == 0.5 for name in wrist)


def test_a_hand_without_a_urdf_asks_for_one(tmp_path: Path) -> None:
    assert needs_urdf("barrett") and not needs_urdf("allegro")
    path = finger(tmp_path / "other")
    (tmp_path / "mine").mkdir()
    toml = tmp_path / "mine" / "hand.toml"
    toml.write_text("base_link = 'palm'")
    for source in (toml.parent, toml):
        hand = load_hand(source, urdf=str(path))
        assert (hand.name, hand.base_link, hand.urdf) == ("mine", "palm", path)
    for source in (path, path.parent):
        with refused(HandError, f"'{source}'", "hand.toml"):
            load_hand(source, urdf=path)
    with refused(HandError, "none.urdf", "No such file"):
        load_hand(toml, urdf=tmp_path / "none.urdf")


def test_an_mjcf_is_named_by_hand_toml_or_given(tmp_path: Path) -> None:
    path = finger(tmp_path, "collision = 'mjcf'\nmjcf_joints = { wrist = 'w' }")
    with refused(HandError, "collision = 'mjcf'", 'mjcf = "FILE"', "`mjcf=FILE`"):
        load_hand(path)
    with refused(HandError, "none.xml"):
        load_hand(path, mjcf=tmp_path / "none.xml")
    (tmp_path / "hand.xml").touch()
    hand = load_hand(path, mjcf=tmp_path / "hand.xml")
    assert (hand.mjcf, hand.collision, hand.mjcf_joints) == (tmp_path / "hand.xml", "mjcf", {"wrist": "w"})
    assert load_hand(path, mjcf=hand.mjcf, base_link="palm").mjcf_joints == {}, "the wrist is left out"


@pytest.mark.parametrize("name", FINGERTIPS)
def test_bare_urdfs_load_with_their_fingertips_guessed(name: str, shared_assets: Path) -> None:
    hand = load_hand(shared_assets / "hands" / name)
    assert hand.name == name and len(hand.joint_names) == JOINTS[name] - 2 * (name == "shadow")
    links = [contact.link for contact in hand.contacts]
    # Phalanges that a tip is fixed to are part of the fingertip.
    assert [link for link in links if link not in ALONG.get(name, ())] == FINGERTIPS[name]
    assert set(ALONG.get(name, ())) <= set(links)
    assert list(hand.fingers) == FINGERS.get(name, FINGERTIPS[name])
    assert hand.contacts_guessed and any(", ".join(links) in note for note in hand.notes)
    np.testing.assert_array_equal(hand.rest, (hand.lower + hand.upper) / 2)
    known = {hand.base_link}
    for j in hand.joints:
        assert j.parent in known, "parents come before children"
        known.add(j.child)
    assert [link.name for link in hand.links] == [hand.base_link, *(j.child for j in hand.joints)]


def test_joint_names_are_in_file_order_though_joints_are_not(shared_assets: Path) -> None:
    hand = load_hand(shared_assets / "hands/leap")
    assert hand.joint_names == tuple(str(i) for i in range(16))
    movable = [j.name for j in hand.joints if j.movable]
    assert movable[:4] == ["1", "0", "2", "3"]
    matrix, offset, names = hand.mimic_map()
    assert list(names) == movable and not offset.any()
    np.testing.assert_array_equal(matrix @ np.arange(16.0), [float(name) for name in movable])


def test_chains_of_mimic_joints_are_resolved(tmp_path: Path) -> None:
    follows = '<mimic joint="{}" multiplier="{}" offset="{}"/>'
    path = write(
        tmp_path,
        dict.fromkeys("abcdef", ""),
        joint("c", "a", "b", inside=follows.format("b", 3, 0.5)),
        joint("b", "b", "c", inside=follows.format("a", -2, 0.25)),
        joint("f", "c", "d", "fixed"),
        joint("a", "d", "e"),
        joint("lone", "e", "f", "continuous", '<mimic joint="a"/>'),
    )
    hand = load_hand(path)
    matrix, offset, names = hand.mimic_map()
    assert hand.joint_names == ("a",) and names == ("c", "b", "a", "lone")
    np.testing.assert_array_equal(matrix, [[-6], [-2], [1], [1]])
    np.testing.assert_array_equal(offset, [1.25, 0.25, 0, 0])
    assert [j.lower for j in hand.joints if j.mimic] == [-1, -1, -np.inf]
    np.testing.assert_allclose((hand.lower, hand.upper, hand.rest), [[-0.125], [0.375], [0.125]], atol=1e-15)
    assert_names(hand.notes[-1], "'a'", "-0.125", "0.375 rad", "-1", "2", " c ")


def test_bodies_and_masses_are_in_place(tmp_path: Path) -> None:
    links = {
        "a": BALL + BALL.replace("sphere radius", 'box size="1 1 1" x'),
        "b": '<inertial><mass value="2"/></inertial>',
    }
    hand = load_hand(write(tmp_path, links, joint("1", "a", "b")), candidates=100)
    a, b = hand.links
    assert len(a.body.pieces) == 2 and len(a.body.candidates.points) == 100 and a.mass is None
    assert b.body is None and b.mass == 2 and a.inertia is None and b.inertia is None


def test_inertias_are_turned_into_the_link_frame(tmp_path: Path) -> None:
    inertial = """<inertial><origin xyz="1 2 3" rpy="0 0 1.5707963267948966"/><mass value="2"/>
      <inertia ixx="1" ixy="0" ixz="0" iyy="2" iyz="0" izz="2.5"/></inertial>"""
    (link,) = load_hand(write(tmp_path, {"a": inertial})).links
    assert link.mass == link.inertia.mass == 2
    np.testing.assert_array_equal(link.inertia.centre, [1, 2, 3])
    np.testing.assert_allclose(link.inertia.matrix, np.diag([2, 1, 2.5]), atol=1e-12)


def test_hand_toml_is_held_against_the_urdf(tmp_path: Path) -> None:
    toml = """
    base_link = "palm"
    rest_pose = { "2" = 1.5 }
    actuator = { kp = { default = 4, "1" = 7 }, force_limit = { "2" = 9 }, armature = 0 }
    contact = [{ link = "near", group = "index", normal = [0, 0, 2] }]
    coupled = [{ joints = ["1", "2"], ratio = [1, 2] }]
    """
    hand = load_hand(finger(tmp_path / "mine", toml))
    assert (hand.name, hand.base_link, hand.joint_names) == ("mine", "palm", ("1", "2"))
    np.testing.assert_array_equal(hand.rest, [0.5, 1.5])
    np.testing.assert_array_equal(hand.actuator.kp, [4, 7][::-1])
    np.testing.assert_array_equal(hand.actuator.force_limit, [3, 9])
    np.testing.assert_array_equal(hand.actuator.armature, 0)
    np.testing.assert_array_equal(hand.actuator.damping, 0.1)
    assert hand.contacts == (Contact("near", "index", None, (0, 0, 1)),)
    assert hand.coupled == (Coupled(("1", "2"), (1, 2)),) and hand.notes == ()


def test_slides_are_driven_like_joints_at_a_lever_of_10_cm(tmp_path: Path) -> None:
    def driven(toml: str) -> list[list[float]]:
        joints = joint("1", "a", "b"), joint("2", "b", "c", "prismatic")
        found = load_hand(write(tmp_path, dict.fromkeys("abc", BALL), *joints, toml=toml)).actuator
        return [getattr(found, key).round(12).tolist() for key in ("kp", "damping", "armature", "frictionloss")]

    assert driven("") == [[5, 500], [0.1, 10], [0.0002, 0.02], [0.01, 0.1]]
    # What is said counts as it is.
    assert driven("actuator = { kp = 3, damping = { '2' = 4 } }")[:2] == [[3, 3], [0.1, 4]]


def test_what_hand_toml_says_of_links_above_the_base_is_left_out(tmp_path: Path) -> None:
    toml = """
    rest_pose = { wrist = 1.5, "1" = 0.25 }
    actuator = { kp = { wrist = 7 } }
    contact = [{ link = "palm" }, { link = "tip" }]
    coupled = [{ joints = ["wrist", "1"] }]
    """
    path = finger(tmp_path, toml)
    assert load_hand(path).joint_names == ("wrist", "1", "2")
    hand = load_hand(path, base_link="near")
    assert hand.joint_names == ("2",) and hand.rest == [0.5] and hand.coupled == ()
    assert hand.contacts == (Contact("tip", "tip"),)
    (note,) = hand.notes
    assert_names(note, "contact", "'palm'")


@pytest.mark.parametrize(
    ("toml", "named"),
    [
        ("base_link = 'wrist'", ("hand.urdf", "'wrist'", "arm, palm, near, tip, frame")),
        ("rest_pose = {x = 1}", ("[rest_pose]", "'x'", "wrist, 1, 2")),
        ("rest_pose = {end = 0}", ("[rest_pose]", "'end'", "wrist, 1, 2")),
        ("rest_pose = {wrist = 2.5}", ("[rest_pose]", "wrist = 2.5", "-1 to 2")),
        ("contact = [{link = 'x'}]", ("[[contact]]", "'x'", "palm, near, tip")),
        ("contact = [{link = 'frame'}]", ("'frame'", "palm, near, tip")),
        ("contact = [{link = 'tip'}, {link = 'tip'}]", ("[[contact]]", "'tip'")),
        ("actuator = {kp = {x = 1}}", ("[actuator]", "kp", "'x'", "wrist, 1, 2")),
        ("coupled = [{joints = ['1', 'x']}]", ("[[coupled]]", "'x'", "wrist, 1, 2")),
        ("coupled = [{joints = ['1', '2']}, {joints = ['2', 'wrist']}]", ("[[coupled]]", "'2'")),
        ("mjcf_joints = {x = 'y'}", ("[mjcf_joints]", "'x'", "wrist, 1, 2")),
        ("mjcf_joints = {'1' = 'y', '2' = 'y'}", ("[mjcf_joints]", "'y'")),
        ("kp = 5", ("hand.toml", "'kp'", "name, urdf, base_link, mjcf, mjcf_joints, collision, patches, rest_pose")),
    ],
)
def test_hand_toml_that_names_nothing(tmp_path: Path, toml: str, named: tuple[str, ...]) -> None:
    with refused(HandError, *named):
        load_hand(finger(tmp_path, toml))


def test_a_hand_is_a_name_a_folder_a_urdf_or_a_hand_toml(tmp_path: Path) -> None:
    path = finger(tmp_path / "bare")
    named = finger(tmp_path / "named", toml="urdf = 'hand.urdf'\nbase_link = 'palm'")
    other = named.with_name("other.urdf")
    other.write_text(named.read_text())
    assert load_hand("allegro").urdf == resource_dir("robots") / "allegro/allegro.urdf"
    assert [load_hand(source).name for source in (path, str(path), path.parent)] == ["hand", "hand", "bare"]
    for source in (named, named.parent, str(named.parent / "hand.toml")):
        hand = load_hand(source)
        assert (hand.name, hand.base_link) == ("named", "palm")
    assert (load_hand(other).name, load_hand(other).base_link) == ("other", "arm"), "hand.toml names another URDF"
    assert load_hand(named, base_link="near").base_link == "near", "the argument wins"


def test_unknown_hands_are_refused_with_the_known_ones(tmp_path: Path) -> None:
    with refused(AssetError, "'alegro'", "allegro"):
        load_hand("alegro")
    with refused(HandError, "none.urdf", "allegro"):
        load_hand(tmp_path / "none.urdf")
    with refused(HandError, tmp_path, ".urdf", "hand.toml"):
        load_hand(tmp_path)
    for name in ("a.urdf", "b.urdf"):
        (tmp_path / name).touch()
    with refused(HandError, tmp_path, "a.urdf, b.urdf"):
        load_hand(tmp_path)
