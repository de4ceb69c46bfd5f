"""Distance between a mesh and its pieces, in closed form for boxes."""

import numpy as np
import pytest
import trimesh

from grasp_refine.geometry.pieces import box, hull
from grasp_refine.geometry.surface_distance import surface_distance, surface_note
from refusals import assert_names

CUBE = trimesh.creation.box([0.1, 0.1, 0.1])


@pytest.mark.parametrize(
    ("extents", "expected"),
    [
        pytest.param([0.1, 0.1, 0.1], 0.0, id="its hull"),
        pytest.param([0.106, 0.1, 0.1], 0.003, id="beyond it"),
        pytest.param([0.094, 0.1, 0.1], 0.003, id="short of it"),
    ],
)
@pytest.mark.parametrize("size", [1.0, 10.0])
def test_a_box_and_its_piece(extents: list[float], expected: float, size: float) -> None:
    mesh = CUBE.copy().apply_scale(size)
    found = surface_distance([box(size * np.array(extents))], mesh)
    assert found == pytest.approx(size * expected, rel=0.02)


def test_a_filled_hollow_counts() -> None:
    """The slope of an L's hull is 1 away from its legs, which are 3 long and 1 wide."""
    legs = [trimesh.creation.box(bounds=[[0, 0, 0], high]) for high in ([3, 1, 1], [1, 3, 1])]
    mesh = trimesh.boolean.union(legs)
    assert surface_distance([hull(mesh.vertices)], mesh) == pytest.approx(1.0, rel=0.06)


def test_the_note_names_millimetres() -> None:
    note = surface_note([box([0.106, 0.1, 0.1])], CUBE)
    assert note is not None
    assert_names(note, "1 convex piece", "3.00 mm")
    assert surface_note([box([0.1, 0.1, 0.1])], CUBE) is None
