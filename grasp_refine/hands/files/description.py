"""The file that describes a hand, a URDF or an MJCF: its tree of links and joints, and its visuals."""

from __future__ import annotations

from pathlib import Path

from grasp_refine.core.errors import HandError
from grasp_refine.hands.files import urdf
from grasp_refine.hands.files.mjcf_xml import is_mjcf
from grasp_refine.hands.files.shape import Shape
from grasp_refine.hands.files.tree import Tree
from grasp_refine.hands.files.urdf_tree import urdf_tree, urdf_visuals


def read_tree(path: Path) -> Tree:
    """Return the tree of links and joints in a URDF or an MJCF.

    Raises:
        HandError: the file cannot be read as either, or its links and joints are not one tree.
    """
    if not is_mjcf(path):
        return urdf_tree(path)
    # This loads MuJoCo, which reading a URDF does without.
    from grasp_refine.hands.files.mjcf_tree import mjcf_tree

    return mjcf_tree(path)


def links_with_visuals(path: Path) -> frozenset[str]:
    """Return the names of the links that have visuals in a URDF or an MJCF.

    Raises:
        HandError: the file cannot be read as either.
    """
    return frozenset(read_visuals(path))


def joints_fixed_and_mimicking(path: Path) -> tuple[str, ...]:
    """Return the names of fixed joints with a mimic, which has no effect there; none in an MJCF.

    Raises:
        HandError: the file cannot be read.
    """
    return () if is_mjcf(path) else urdf.joints_fixed_and_mimicking(path)


def read_visuals(path: Path) -> dict[str, list[Shape | HandError]]:
    """Return the visuals of each link in a URDF or an MJCF; for a broken one, its error.

    Raises:
        HandError: the file cannot be read as either.
    """
    if not is_mjcf(path):
        return urdf_visuals(path)
    from grasp_refine.hands.files.mjcf_tree import mjcf_visuals

    return mjcf_visuals(path)
