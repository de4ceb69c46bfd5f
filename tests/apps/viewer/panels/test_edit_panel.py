"""Panel that edits the grasp, with the real controller and viser server, on the embedded example."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from grasp_refine.core.se3 import exp_so3
from grasp_refine.hands.hand import load_hand
from grasp_refine.problem.load import load_problem
from grasp_refine.problem.problem import Problem
from grasp_refine_apps.commands.inputs import Inputs
from grasp_refine_apps.viewer.jobs import editor
from grasp_refine_apps.viewer.jobs.controller import Controller
from grasp_refine_apps.viewer.model.collection import Collection
from grasp_refine_apps.viewer.panels.edit_panel import EditPanel, targets_text
from grasp_refine_apps.viewer.panels.joints import limits, units
from open_viewer import controller, shown_panel
from plate_gripper import URDF
from websocket_page import Page, until

TIP = "link_3.0_tip"


Shown = tuple[Controller, EditPanel, Page]


@pytest.fixture
def shown(problem: Problem) -> Iterator[Shown]:
    made = controller(problem)
    with shown_panel(EditPanel, made) as (panel, page):
        until(lambda: panel.joints.sliders)
        yield made, panel, page


def handles(panel: EditPanel) -> list[Any]:
    """The sliders of the joints."""
    return [slider.handle for slider in panel.joints.sliders]


def test_there_is_a_slider_for_each_joint_within_its_limits_and_a_drag_is_one_step(
    shown: Shown, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(editor, "MERGE_WINDOW_S", np.inf)  # a busy machine takes its time for each change
    made, panel, page = shown
    hand, before = made.state.collection.hand, made.state.pose.q.copy()
    sliders = handles(panel)
    assert [slider.label for slider in sliders] == list(hand.joint_names)
    np.testing.assert_allclose([slider.min for slider in sliders], np.degrees(hand.lower), atol=0.051)
    np.testing.assert_allclose([slider.max for slider in sliders], np.degrees(hand.upper), atol=0.051)
    until(lambda: np.allclose([slider.value for slider in sliders], np.degrees(before), atol=0.051))
    for degrees in np.linspace(10.0, 40.0, 16):
        page.change(sliders[1], float(degrees))
    dragged = np.where(np.arange(len(before)) == 1, np.radians(40.0), before)
    until(lambda: np.allclose(made.state.pose.q, dragged, atol=1e-9))
    assert sliders[1].value == 40.0
    until(lambda: not panel.undo.disabled)
    page.change(panel.undo, True)
    until(lambda: made.state.pose.q.tolist() == before.tolist())
    # The slider follows when nobody holds it any more.
    until(lambda: abs(sliders[1].value - np.degrees(before[1])) < 0.051)
    until(lambda: panel.undo.disabled and not panel.redo.disabled)
    page.change(panel.redo, True)
    until(lambda: np.allclose(made.state.pose.q, dragged, atol=1e-9))


def test_the_pose_can_be_typed_and_only_one_body_has_a_gizmo(shown: Shown):
    made, panel, page = shown

    def T() -> np.ndarray:
        return made.state.pose.T_object_root

    before, position, rotation = T(), panel.position.handle, panel.rotation.handle
    until(lambda: np.allclose(position.value, 1e3 * before[:3, 3], atol=0.051))
    page.change(position, [10.0, -20.0, 30.0])
    until(lambda: np.allclose(T()[:3, 3], [0.01, -0.02, 0.03]))
    # Turned by nothing, though its rotation is shown in tenths of a degree.
    assert T()[:3, :3].tolist() == before[:3, :3].tolist()
    page.change(rotation, [0.0, 90.0, 0.0])
    until(lambda: np.allclose(T()[:3, :3], exp_so3(np.array([0.0, np.pi / 2, 0.0])), atol=1e-12))
    until(lambda: rotation.value == (0.0, 90.0, 0.0))
    hand, thing = (panel.gizmos[what].handle for what in ("hand", "object"))
    for widget, value, gizmo in ((hand, True, "hand"), (thing, True, "object"), (thing, False, "none")):
        page.change(widget, value)
        until(lambda gizmo=gizmo: made.state.gizmo == gizmo)
        until(lambda gizmo=gizmo: (hand.value, thing.value) == (gizmo == "hand", gizmo == "object"))


def test_targets_are_set_listed_and_deleted(shown: Shown):
    made, panel, page = shown
    text, delete = panel.targets, panel.delete
    until(lambda: text.content)
    page.change(panel.picking.handle, True)
    until(lambda: made.state.picking)
    made.targets.pick_link(TIP, np.zeros(3))
    until(lambda: TIP in text.content)
    made.targets.pick_object(np.array([0.01, 0.02, 0.03]))
    until(lambda: f"| {TIP} |" in text.content and "| 10, 20, 30 |" in text.content)
    until(lambda: delete.visible and delete.options == (TIP,))
    page.change(delete, TIP)
    until(lambda: made.state.targets == () and not delete.visible)
    page.change(panel.nearest, True)
    until(lambda: len(made.state.targets) > 1 and len(delete.options) == len(made.state.targets))
    # The list has the error of the heading.
    targets = made.state.targets
    moved = replace(targets[0], point_object=targets[0].point_object + np.array([0.003, 0.0, 0.004]))
    state = made.state.evolve(targets=(moved, *targets[1:]))
    found = made.contacts(state)
    listed = targets_text(state, found)
    assert f"| {moved.link} | {1e3 * found.contact_error:.2f} |" in listed and found.contact_error > 4e-3
    assert len([line for line in listed.splitlines() if line.startswith("| ")]) == len(targets) + 1
    page.change(panel.auto, True)
    until(lambda: made.state.targets == ())


def test_another_hand_has_other_sliders_in_millimetres_and_without_end(shown: Shown, tmp_path: Path):
    made, panel, page = shown
    (tmp_path / "plates.urdf").write_text(URDF)
    inputs = Inputs(hand=str(tmp_path / "plates.urdf"), object="sphere:0.03", grasps=Path("sample:1"))
    first = handles(panel)[0]
    made.grasps.open(Collection.of(load_problem(inputs)))
    until(lambda: [slider.label for slider in handles(panel)] == ["l", "r"])
    assert first._impl.removed
    left, right = handles(panel)
    assert (left.min, left.max) == (0.0, 70.0)
    page.change(right, -12.5)
    until(lambda: abs(made.state.pose.q[1] + 0.0125) < 1e-9)
    turning = URDF.replace('name="r" type="prismatic"', 'name="r" type="continuous"').replace(
        '<limit lower="-0.07" upper="0" effort="1" velocity="1"/>', ""
    )
    (tmp_path / "turning.urdf").write_text(turning)
    hand = load_hand(tmp_path / "turning.urdf", candidates=16)
    np.testing.assert_allclose(units(hand), [1e3, 180.0 / np.pi])
    np.testing.assert_allclose(limits(hand, 0, 1e3), (0.0, 70.0))
    assert limits(hand, 1, 180.0 / np.pi) == (-180.0, 180.0)

    # More than half a turn is shown as less than one the other way. The viewer may draw its own hand in between.
    def less_than_half_a_turn() -> bool:
        with made.lock:
            panel.joints.draw(hand, np.array([0.01, np.radians(270.0)]))
        return handles(panel)[1].value == -90.0

    until(less_than_half_a_turn)


def test_regions_are_applied_as_they_were_written_and_shown_as_they_are(shown: Shown):
    made, panel, page = shown
    regions = panel.regions
    page.change(regions.touch, "above:z=0.02; below:z=0.01")
    page.change(regions.avoid, "above:z=0.08")
    page.change(regions.apply, True)
    until(lambda: made.state.scene.regions is not None)
    found = made.state.scene.regions
    assert [one.spec for one in found.touch] == ["above:z=0.02", "below:z=0.01"]
    assert [one.spec for one in found.avoid] == ["above:z=0.08"]
    until(lambda: not regions.clear.disabled)  # the page shows them
    page.change(panel.undo, True)
    until(lambda: regions.touch.value == regions.avoid.value == "" and regions.clear.disabled)
    assert made.state.scene.regions is None
    page.change(panel.redo, True)
    until(lambda: regions.avoid.value == "above:z=0.08")
    page.change(regions.clear, True)
    until(lambda: made.state.scene.regions is None)
    page.change(regions.brush, "touch")
    until(lambda: made.state.brush == "touch" and regions.advice.visible)
