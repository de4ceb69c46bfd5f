"""Visual geometry of a URDF in place of its collision geometry, which some hands lack."""

from __future__ import annotations

from dataclasses import replace

from grasp_refine.core.errors import HandError
from grasp_refine.hands.files.description import read_visuals
from grasp_refine.hands.files.mjcf_xml import is_mjcf
from grasp_refine.hands.files.shape import Shape
from grasp_refine.hands.files.tree import Tree


def with_visual_collision(tree: Tree) -> Tree:
    """Return the tree of a URDF whose links collide as they look; a link without visuals keeps its geometry.

    Raises:
        HandError: the file is an MJCF, or a visual is broken.
    """
    if is_mjcf(tree.path):
        raise HandError(f"{tree.path}: visual geometry collides in place of that of a URDF only, this is an MJCF")
    links = dict(tree.links)
    for link, visuals in read_visuals(tree.path).items():
        shapes: list[Shape] = []
        for visual in visuals:
            if isinstance(visual, HandError):
                raise visual
            shapes.append(visual)
        links[link] = replace(links[link], collisions=tuple(shapes))
    return replace(tree, links=links)
