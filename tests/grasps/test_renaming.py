"""Grasps of a hand whose other file has a prefix before its names."""

import numpy as np

from grasp_refine.grasps.grasp_set import GraspSet, Targets
from grasp_refine.grasps.renaming import with_prefixes


def grasps(targets: Targets | None = None) -> GraspSet:
    pose = np.array([[0.0, 0, 0, 1, 0, 0, 0]])
    return GraspSet("h", "palm", ("FFJ4", "THJ1"), np.array(["mug"]), np.ones(1), pose, np.array([[0.1, 0.2]]), targets)


LINKS, JOINTS = ("rh_forearm", "rh_palm", "rh_fftip"), ("rh_WRJ1", "rh_THJ1", "rh_FFJ4")


def test_links_joints_and_targets_get_the_prefix_and_values_stay() -> None:
    aimed = grasps(Targets(("fftip",), np.zeros((1, 1, 3)), np.ones((1, 1, 3))))
    found = with_prefixes(aimed, LINKS, JOINTS)
    assert found is not None and found.targets is not None
    assert (found.base_link, found.joint_names) == ("rh_palm", ("rh_FFJ4", "rh_THJ1"))
    assert found.targets.links == ("rh_fftip",)
    np.testing.assert_array_equal(found.q, aimed.q)


def test_a_name_that_is_missing_or_ambiguous_is_none() -> None:
    assert with_prefixes(grasps(), LINKS, ("rh_FFJ4",)) is None
    assert with_prefixes(grasps(), (*LINKS, "lh_palm"), JOINTS) is None
    assert with_prefixes(grasps(), LINKS, (*JOINTS, "lh_FFJ4")) is None
