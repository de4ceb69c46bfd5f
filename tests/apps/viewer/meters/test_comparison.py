"""The grasp of the same number of other grasps: drawn where it is, with its own numbers."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.se3 import exp_so3, transform, transform_from_pose
from grasp_refine.problem.problem import Problem
from grasp_refine_apps.commands.settings import Settings
from grasp_refine_apps.viewer.drawing.view import View
from grasp_refine_apps.viewer.jobs.controller import Controller
from grasp_refine_apps.viewer.meters.comparison import compared_pose, compared_text
from grasp_refine_apps.viewer.model.collection import Collection
from grasp_refine_apps.viewer.model.columns import numeric_columns
from grasp_refine_apps.viewer.panels.browse_panel import NOTHING, BrowsePanel
from open_viewer import example, shown_panel
from refusals import assert_names
from websocket_page import until

AWAY_M = 0.02


@pytest.fixture(scope="module")
def other(problem: Problem) -> Collection:
    """The example without its last grasp, each hand 2 cm higher and turned by 10 degrees; with measures."""
    (group,) = problem.groups
    rows = group.rows[:-1]
    T = group.scene.T_world_root[:-1] @ transform(exp_so3(np.radians([0.0, 10.0, 0.0])), np.zeros(3))
    T[:, 2, 3] += AWAY_M
    scene = replace(group.scene.select(slice(-1)), T_world_root=T)
    moved = replace(
        group, scene=scene, grasps=group.grasps.select(rows), rows=rows, index=group.index[:-1], place=group.place[:-1]
    )
    made = Collection.of(replace(problem, groups=(moved,), files=()))
    (quality,) = (column for column in numeric_columns() if column.key == "quality_after")
    return made.with_columns(quality.with_values(np.array([0.625, 0.5, 0.25])))


@pytest.fixture
def viewer(problem: Problem, other: Collection) -> Iterator[Controller]:
    made = Controller(Collection.of(problem), Settings(), other)
    yield made
    made.close()


def test_the_ghost_is_the_grasp_of_the_same_number(view: View, viewer: Controller, other: Collection) -> None:
    for number in (0, 2):
        viewer.grasps.show(number)
        view.draw(viewer.state)
        ghost = view.nodes.ghost
        first = ghost.shapes[0].link
        found = transform_from_pose(np.concatenate([ghost.nodes[0].position, ghost.nodes[0].wxyz])[None])[0]
        wanted = ghost.poses(other.pose(number).T_object_root, other.pose(number).q)[first]
        np.testing.assert_allclose(found, wanted, atol=1e-7)
        assert ghost.nodes[0].visible
    viewer.grasps.compare(None)
    view.draw(viewer.state)
    assert not view.nodes.ghost.nodes[0].visible, "the grasp is as in its file"


def test_its_numbers_are_as_the_other_file_would_show(viewer: Controller, other: Collection) -> None:
    alone = Controller(other, Settings())
    error = 1e3 * alone.contacts(alone.state).contact_error
    alone.close()
    text = compared_text(viewer.state, viewer.contacts)
    assert_names(text, f"{error:.2f} mm", f"{1e3 * AWAY_M:.1f} mm", "10.0°", "0.625")
    # The last grasp has no other, nor has one on an object of another scale.
    (group,) = other.problem.groups
    scaled = replace(other, problem=replace(other.problem, groups=(replace(group, scale=2.0),)))
    assert compared_pose(replace(viewer.state, compared=replace(viewer.state.compared, collection=scaled))) is None
    viewer.grasps.show(len(other))
    assert compared_pose(viewer.state) is None and str(len(other)) in compared_text(viewer.state, viewer.contacts)


def test_opening_the_other_file_compares_it_with_the_first(viewer: Controller, other: Collection) -> None:
    first = viewer.state.collection
    viewer.grasps.reopen(0)
    assert viewer.state.collection.same_grasps(other)
    compared = viewer.state.compared
    assert compared is not None and compared.collection.same_grasps(first)
    # An edit of the one that is not shown is compared, too.
    viewer.grasps.reopen(0)
    viewer.editor.set_joint(0, viewer.state.pose.q[0] + 0.05)
    edited = viewer.state.pose
    viewer.grasps.reopen(0)
    pose = compared_pose(viewer.state)
    assert pose is not None and pose.same(edited)


def test_the_list_of_open_files_chooses_what_is_compared(viewer: Controller, other: Collection) -> None:
    with shown_panel(BrowsePanel, viewer) as (panel, page):
        until(lambda: panel.compared.value != NOTHING)
        title = panel.compared.value
        assert panel.compared.options == (NOTHING, title)
        page.change(panel.compared, NOTHING)
        until(lambda: viewer.state.compared is None)
        page.change(panel.compared, title)
        until(lambda: viewer.state.compared is not None)
        assert viewer.state.compared.collection.same_grasps(other)


def test_grasps_of_another_hand_are_refused(problem: Problem) -> None:
    leap = Collection.of(example(hand="leap"))
    with pytest.raises(GraspRefineError, match="allegro"):
        Controller(Collection.of(problem), Settings(), leap)
