"""Every hand of robots/: moves like the maker's, is made of possible matter, collides with nothing at rest, grasps."""

import json
import re
from functools import cache
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest

from grasp_refine.assets.embedded import resource_dir
from grasp_refine.core.se3 import transform_from_pose, transform_points
from grasp_refine.grasps.grasp_set import load_grasps, match_joints
from grasp_refine.hands.chain import Chain
from grasp_refine.hands.files.hand_toml import read_hand_toml
from grasp_refine.hands.files.source import needs_urdf
from grasp_refine.hands.hand import Hand, list_hands, load_hand
from grasp_refine.hands.self_collision import self_penetration, touching_pairs
from grasp_refine.measures.geometry import measure
from grasp_refine.measures.metrics import metrics
from grasp_refine.objects.object import load_object
from grasp_refine.refinement.refine import refine
from grasp_refine.refinement.solvers.status import Status
from grasp_refine.results.verdict import HOLDS
from grasp_refine.scene.hand_object import HandObject
from grasp_refine.scene.scene import Scene
from grasp_refine.validation.engines.mujoco.urdf_model import urdf_model
from grasp_refine_apps.report.hand_facts import licence

WHOLE = tuple(name for name in list_hands() if not needs_urdf(name))
"""Hands that come with a URDF."""

MAKERS = {
    "allegro": "allegro/allegro_right.urdf",
    "leap": "leap/leap_right.urdf",
    "shadow": "shadow/shadow_right.urdf",
    "shadow_palm": "shadow/shadow_right.urdf",
    "barrett": "barrett/barrett.urdf",
    "robotiq3f": "robotiq3f/robotiq3f.urdf",
}
"""The maker's URDF of each, in the shared assets."""

FACTS = {"allegro": ("urdf", "BSD-2-Clause"), "leap": ("urdf", "MIT"), "shadow": ("mjcf", "Apache-2.0")}
"""Whose facts the URDF is after, and their licence."""

PUBLISHED = {
    "franka_hand": {
        "licence": "Apache-2.0",
        "masses": {"panda_hand": 0.73, "panda_leftfinger": 0.015, "panda_rightfinger": 0.015},
        "limits": {"panda_finger_joint1": (0.0, 0.04)},
        # At 0: of the fingertips' rubber, and of the frame between them.
        "points": {
            "panda_leftfinger": (0.0, 0.0, 0.0584 + 0.04525),
            "panda_rightfinger": (0.0, 0.0, 0.0584 + 0.04525),
            "panda_hand_tcp": (0.0, 0.0, 0.1034),
        },
        "force": 70.0,
    }
}
"""Facts of hands whose maker's URDF is not in the shared assets, from its description and its data sheet."""

JOINTS = dict(allegro=16, barrett=8, franka_hand=1, leap=16, robotiq3f=11, shadow=24, shadow_palm=22)
"""Independent joints."""

SLOW = ("mug", "bottle")
"""Objects that each hand has example grasps of, besides the rounded box, and that are cut into pieces first."""


@cache
def ours(name: str) -> Hand:
    return load_hand(name)


def facts_of(name: str, shared_assets: Path) -> dict:
    return json.loads((shared_assets / f"facts/{name.removesuffix('_palm')}.json").read_text())


def random_configurations(hand: Hand, count: int = 100) -> np.ndarray:
    return np.random.default_rng(0).uniform(hand.lower, hand.upper, (count, len(hand.lower)))


def poses(hand: Hand, links: tuple[str, ...], q: np.ndarray) -> np.ndarray:
    return Chain(hand, links)(np.tile(np.eye(4), (len(q), 1, 1)), q).T_world_link


def test_the_hands_are_these() -> None:
    assert set(list_hands()) == set(JOINTS) and set(WHOLE) == {
        "allegro",
        "franka_hand",
        "leap",
        "shadow",
        "shadow_palm",
    }
    for name in WHOLE:
        hand = ours(name)
        assert hand.name == name and len(hand.joint_names) == JOINTS[name] and hand.notes == ()


@pytest.mark.parametrize("name", [*FACTS, *PUBLISHED])
def test_the_urdf_says_whose_it_is_and_whose_facts_it_is_after(name: str) -> None:
    assert licence(ours(name).urdf) == "Apache-2.0"
    terms = FACTS[name][1] if name in FACTS else PUBLISHED[name]["licence"]
    text = ours(name).urdf.read_text()
    comment = " ".join(text[text.index("<!--") : text.index("-->")].split())
    assert "grasp-refine (Apache-2.0)" in comment and f"{terms})" in comment
    assert all(name.startswith("visual/") for name in re.findall(r"<mesh filename=\"(.*?)\"", text))


def test_shadow_palm_is_shadow_from_the_palm_on() -> None:
    texts = [(resource_dir("robots") / name / "hand.toml").read_text() for name in ("shadow", "shadow_palm")]
    whole, palm = (text[re.search("^base_link.*\n", text, re.MULTILINE).end() :] for text in texts)
    assert whole == palm, "below base_link, both files say the same"
    assert ours("shadow").urdf.samefile(ours("shadow_palm").urdf)
    assert ours("shadow").joint_names == ("WRJ2", "WRJ1", *ours("shadow_palm").joint_names)
    for name, base in (("shadow", "forearm"), ("shadow_palm", "palm")):
        assert ours(name).base_link == base and len(ours(name).contacts) == 5 and len(ours(name).coupled) == 4


@pytest.mark.parametrize("name", PUBLISHED)
def test_it_is_as_published(name: str) -> None:
    hand, facts = ours(name), PUBLISHED[name]
    assert {link.name: link.mass for link in hand.links if link.mass is not None} == facts["masses"]
    limits = zip(hand.lower.tolist(), hand.upper.tolist(), strict=True)
    assert dict(zip(hand.joint_names, limits, strict=True)) == facts["limits"]
    assert all(hand.joints_by_name[name].effort == facts["force"] for name in hand.joint_names)
    pads = {contact.link: contact.point for contact in hand.contacts}
    links = tuple(facts["points"])
    T = poses(hand, links, np.zeros((1, len(hand.lower))))[0]
    points = transform_points(T, np.array([pads.get(link, (0.0, 0.0, 0.0)) for link in links]))
    np.testing.assert_allclose(points, list(facts["points"].values()), atol=1e-9)


@pytest.mark.parametrize("name", [name for name in WHOLE if name in MAKERS])
def test_all_links_are_where_the_makers_are(name: str, shared_assets: Path) -> None:
    base_link = {"allegro": "base_link", "leap": "base"}.get(name, "world" if name == "shadow" else "palm")
    hand = load_hand(name, base_link=base_link, candidates=16)
    maker = load_hand(shared_assets / "hands" / MAKERS[name], base_link=base_link, candidates=16)
    assert {link.name for link in hand.links} == {link.name for link in maker.links}
    assert {joint.name for joint in hand.joints} == {joint.name for joint in maker.joints}
    assert hand.joint_names == maker.joint_names, "values without names are in the maker's order"
    np.testing.assert_allclose(hand.lower, maker.lower, atol=1e-9)
    np.testing.assert_allclose(hand.upper, maker.upper, atol=1e-9)
    links, q = tuple(link.name for link in hand.links), random_configurations(hand)
    here, there = poses(hand, links, q), poses(maker, links, q)
    assert np.linalg.norm(here[..., :3, 3] - there[..., :3, 3], axis=-1).max() < 1e-5
    np.testing.assert_allclose(here[..., :3, :3], there[..., :3, :3], atol=1e-4)


@pytest.mark.parametrize("name", FACTS)
def test_masses_are_the_published_ones(name: str, shared_assets: Path) -> None:
    facts = facts_of(name, shared_assets)[FACTS[name][0]]
    weighed = {part["name"].removeprefix("rh_"): part["mass"] for part in facts.get("links", facts.get("bodies"))}
    for link in ours(name).links:
        assert link.mass == weighed.get(link.name), link.name


@pytest.mark.parametrize("name", [*FACTS, *PUBLISHED])
def test_masses_are_spread_evenly_over_the_shapes(name: str) -> None:
    rng = np.random.default_rng(0)
    for link in ours(name).links:
        assert (link.inertia is None) == (link.body is None), link.name
        if link.body is None:
            continue
        low, middle, high = np.linalg.eigvalsh(link.inertia.matrix)
        assert low > 0 and low + middle >= high, link.name
        bounds = np.stack([piece.bounds for piece in link.body.pieces])
        low, high = bounds[:, 0].min(axis=0), bounds[:, 1].max(axis=0)
        points = rng.uniform(low, high, (20000, 3))
        inside = np.zeros(len(points), dtype=bool)
        for piece in link.body.pieces:
            if piece.radius > 0:
                inside |= np.linalg.norm(points - piece.vertices[0], axis=1) <= piece.radius
            else:
                normals, offsets = piece.planes
                inside |= (points @ normals.T <= offsets).all(axis=1)
        points = points[inside]
        np.testing.assert_allclose(link.inertia.centre, points.mean(axis=0), atol=0.02 * np.ptp(points, axis=0).max())
        spread = link.mass * np.cov(points.T, bias=True)
        expected = np.trace(spread) * np.eye(3) - spread
        np.testing.assert_allclose(link.inertia.matrix, expected, atol=0.03 * np.trace(expected), err_msg=link.name)


@pytest.mark.parametrize("name", WHOLE)
def test_nothing_collides_at_rest(name: str) -> None:
    hand = ours(name)
    assert ((hand.lower < hand.rest) & (hand.rest < hand.upper)).all()
    # Pairs that overlap at rest are not watched later on: there are none but those that one or two joints connect.
    parent = {joint.child: joint.parent for joint in hand.joints}
    near = {frozenset(pair) for pair in parent.items()}
    near |= {frozenset((child, parent[above])) for child, above in parent.items() if above in parent}
    solid = [link.name for link in hand.links if link.body is not None]
    apart = [pair for pair in combinations(solid, 2) if frozenset(pair) not in near]
    assert self_penetration(hand, [*apart, *touching_pairs(hand)], hand.rest[None])[0] == 0


@pytest.mark.parametrize("name", WHOLE)
def test_mujoco_takes_them_as_they_are(name: str) -> None:
    made = urdf_model(ours(name))
    assert made.notes == ()
    followers = sum(joint.mimic is not None for joint in ours(name).joints)
    assert made.spec.compile().nv == JOINTS[name] + followers


@pytest.mark.parametrize("name", WHOLE)
def test_pads_are_on_the_surface_and_look_the_way_the_finger_closes(name: str) -> None:
    hand = ours(name)
    for contact in hand.contacts:
        cloud = hand.links_by_name[contact.link].body.candidates
        near = np.linalg.norm(cloud.points - np.array(contact.point), axis=1).argmin()
        height = (contact.point - cloud.points[near]) @ cloud.normals[near]
        assert abs(height) < 2e-4, contact.link
        assert cloud.normals[near] @ contact.normal > np.cos(np.radians(10)), contact.link


@pytest.mark.parametrize("name", WHOLE)
@pytest.mark.parametrize("things", [pytest.param(("rounded_box", *SLOW), marks=pytest.mark.slow), ("rounded_box",)])
def test_its_examples_refine(name: str, things: tuple[str, ...]) -> None:
    hand, converged = ours(name), []
    for thing in things:
        obj = load_object(thing)
        grasps = load_grasps(resource_dir("robots") / name / f"example_{thing}.npz")
        assert (grasps.hand, grasps.base_link, set(grasps.object)) == (name, hand.base_link, {thing})
        q, notes = match_joints(grasps, hand)
        assert not notes and ((hand.lower <= q) & (q <= hand.upper)).all() and len(q) >= 3
        scene = Scene(hand, obj, transform_from_pose(grasps.hand_pose), q)
        result = refine(scene)
        before, after = (
            measure(HandObject.of(scene), T, q, result.target_link, result.target_object, touching=result.touching)
            for T, q in ((scene.T_world_root, scene.q), (result.T_world_root, result.q))
        )
        tips = before.distance[:, : len(hand.contacts)].max(axis=1)
        assert (tips > 0.005).all() and (tips < 0.016).all(), "almost right"
        assert (before.penetration > 0.001).all() and (before.penetration < 0.004).all()
        assert np.nanmax(after.contact_error) < 1e-3 and after.penetration.max() < 2e-5
        good = metrics(hand, obj, result.T_world_root, result.q).quality >= HOLDS
        assert good.mean() >= 0.75, "of two fingers one in four may slip"
        converged += list(result.status == Status.CONVERGED)
    # Of the attempts at a grasp the one that holds best is taken: one in ten ends a little short of its last contact.
    assert np.mean(converged) >= 0.75


@pytest.mark.parametrize("name", [name for name in list_hands() if name not in WHOLE])
def test_what_we_say_of_a_hand_fits_its_urdf(name: str, shared_assets: Path) -> None:
    hand = load_hand(name, urdf=shared_assets / "hands" / MAKERS[name], candidates=4096)
    assert hand.name == name and len(hand.joint_names) == JOINTS[name]
    assert all("hull" in note for note in hand.notes), "nothing is guessed or left out"
    toml = read_hand_toml(resource_dir("robots") / name / "hand.toml")
    assert set(toml.rest_pose) == set(hand.joint_names) and hand.contacts == toml.contacts
    assert len({contact.group for contact in hand.contacts}) == len(hand.contacts) == 3
    assert ((hand.lower < hand.rest) & (hand.rest < hand.upper)).all()
    assert self_penetration(hand, touching_pairs(hand), hand.rest[None])[0] == 0
    for contact in hand.contacts:
        cloud = hand.links_by_name[contact.link].body.candidates
        near = np.linalg.norm(cloud.points - np.array(contact.point), axis=1).argmin()
        height = (contact.point - cloud.points[near]) @ cloud.normals[near]
        assert abs(height) < 1e-4, f"{contact.link}: the pad is on the surface"
        assert cloud.normals[near] @ contact.normal > np.cos(np.radians(5))
    assert (hand.actuator.kp > 0).all() and np.isfinite(hand.actuator.force_limit).all()
