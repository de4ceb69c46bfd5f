"""Patches of contact: how far they are outside of regions, by the geometry of boxes, balls and cylinders."""

import numpy as np
import pytest

from grasp_refine.collision.query import Pairs, query
from grasp_refine.core.rpy_poses import transform_from_rpy
from grasp_refine.geometry.body import Body, build_body
from grasp_refine.geometry.pieces import Piece, box, capsule, sphere
from grasp_refine.objects.region import ContactRegions, HalfSpace
from grasp_refine.scene.contact_patches import PATCH_M, patch_misses

BLOCK = build_body("block", [box([0.1, 0.1, 0.1])], candidates=256)


def beyond(x: float) -> ContactRegions:
    """Return regions that forbid what is beyond x."""
    return ContactRegions((), (HalfSpace("", np.array([1.0, 0.0, 0.0]), x),))


def miss(link: Piece, pose: list[float], regions: ContactRegions, obj: Body = BLOCK) -> tuple[float, np.ndarray]:
    """Return how far a link at a pose touches an object outside of regions, and where."""
    body = build_body("link", [link], candidates=256)
    T = transform_from_rpy(pose)[None, None]
    witness = query(Pairs.against((body,), obj), T, np.eye(4)[None, None])
    found = patch_misses(regions, (body,), obj, T, witness)
    return float(found.miss[0, 0]), found.point[0, 0]


@pytest.mark.parametrize("gap", [-1e-4, 0.0, 2e-4])
@pytest.mark.parametrize("turn", [0.0, 45.0])
def test_flat_palm_counts_as_far_as_it_lies_on_the_object(gap: float, turn: float) -> None:
    """A plate of 60 mm on the top of a block of 100 mm reaches 30 mm, its corner 42 mm, wherever the
    witness point is."""
    found, point = miss(box([0.06, 0.06, 0.01]), [0.0, 0.0, 0.055 + gap, 0.0, 0.0, turn], beyond(0.016))
    reach = 0.03 if turn == 0.0 else 0.03 * np.sqrt(2.0)
    assert found == pytest.approx(reach - 0.016, abs=1e-9)
    assert point[0] == pytest.approx(reach) and point[2] == pytest.approx(0.05, abs=1.1 * PATCH_M)


def test_edges_of_the_object_end_a_patch() -> None:
    """A plate larger than the block touches as far as the block goes; the corner of neither is in the other."""
    found, _ = miss(box([0.3, 0.02, 0.01]), [0.0, 0.0, 0.055, 0.0, 0.0, 0.0], beyond(0.02))
    assert found == pytest.approx(0.05 - 0.02, abs=1e-9)


def test_ball_touches_within_the_circle_that_is_near_enough() -> None:
    """Of radius r on a plane, up to sqrt(2 r h) from its foot, and not at all from h on."""
    radius, at = 0.02, 0.01
    found, _ = miss(sphere(radius), [at, 0.0, 0.05 + radius, 0.0, 0.0, 0.0], beyond(at + 0.001))
    reach = np.sqrt(2 * radius * PATCH_M) - 0.001
    assert abs(found - reach) < 3e-4
    apart, _ = miss(sphere(radius), [at, 0.0, 0.05 + radius + 2 * PATCH_M, 0.0, 0.0, 0.0], beyond(at + 0.001))
    assert apart == 0.0
    witness, point = miss(sphere(radius), [at, 0.0, 0.05 + radius + 1e-3, 0.0, 0.0, 0.0], beyond(at - 0.003))
    assert witness == pytest.approx(0.003, abs=1e-6) and point[0] == pytest.approx(at, abs=1e-6)


def test_finger_along_the_object_counts_over_its_length() -> None:
    """A capsule that lies on the block along x touches up to the end of its axis."""
    finger = capsule(0.008, [-0.02, 0.0, 0.0], [0.02, 0.0, 0.0])
    found, _ = miss(finger, [0.0, 0.0, 0.058, 0.0, 0.0, 0.0], beyond(0.005))
    assert 0.014 < found < 0.015 + np.sqrt(2 * 0.008 * PATCH_M)


def test_links_elsewhere_and_regions_that_hold_the_patch_cost_nothing() -> None:
    """A plate above the block, and one whose patch ends where the region does."""
    assert miss(box([0.06, 0.06, 0.01]), [0.0, 0.0, 0.06, 0.0, 0.0, 0.0], beyond(-0.05))[0] == 0.0
    assert miss(box([0.06, 0.06, 0.01]), [0.0, 0.0, 0.055, 0.0, 0.0, 0.0], beyond(0.03))[0] == pytest.approx(0.0)
