"""Panel that edits the grasp, with the real controller and viser server, on the embedded example."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
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
from open_viewer import controller, settled, shown_panel
from plate_gripper import URDF
from websocket_page import Page, until

TIP = "link_3.0_tip"


@dataclass
class Shown:
    """A page with the panel."""

    controller: Controller
    panel: EditPanel
    page: Page

    def press(self, name: str) -> None:
        self.page.change(getattr(self.panel, name), True)

    @property
    def sliders(self) -> list[Any]:
        return [slider.handle for slider in self.panel.joints.sliders]

    @property
    def q(self) -> np.ndarray:
        return self.controller.state.pose.q


@pytest.fixture
def shown(problem: Problem) -> Iterator[Shown]:
    made = controller(problem)
    with shown_panel(EditPanel, made) as (panel, page):
        until(lambda: panel.joints.sliders)
        yield Shown(made, panel, page)


def test_there_is_a_slider_for_each_joint_by_finger_within_its_limits(shown: Shown):
    hand = shown.controller.state.collection.hand
    assert [slider.label for slider in shown.sliders] == list(hand.joint_names)
    assert [part.label for part in shown.panel.joints._parts] == ["Index", "Middle", "Ring", "Thumb"]
    degrees = np.degrees([hand.lower, hand.upper])
    np.testing.assert_allclose([slider.min for slider in shown.sliders], degrees[0], atol=0.051)
    np.testing.assert_allclose([slider.max for slider in shown.sliders], degrees[1], atol=0.051)
    until(lambda: np.allclose([slider.value for slider in shown.sliders], np.degrees(shown.q), atol=0.051))


def test_a_slider_that_is_dragged_is_one_step_of_undo(shown: Shown, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(editor, "MERGE_WINDOW_S", np.inf)  # a busy machine takes its time for each change
    before = shown.q.copy()
    slider = shown.sliders[1]
    for degrees in np.linspace(10.0, 40.0, 16):
        shown.page.change(slider, float(degrees))
    until(lambda: abs(shown.q[1] - np.radians(40.0)) < 1e-9)
    assert np.delete(shown.q, 1).tolist() == np.delete(before, 1).tolist()
    assert slider.value == 40.0
    until(lambda: not shown.panel.undo.disabled)
    shown.press("undo")
    until(lambda: shown.q.tolist() == before.tolist())
    # The slider follows when nobody holds it any more.
    until(lambda: abs(slider.value - np.degrees(before[1])) < 0.051)
    until(lambda: shown.panel.undo.disabled and not shown.panel.redo.disabled)
    shown.press("redo")
    until(lambda: abs(shown.q[1] - np.radians(40.0)) < 1e-9)


def test_the_pose_can_be_typed(shown: Shown):
    before = shown.controller.state.pose.T_object_root
    position, rotation = shown.panel.position.handle, shown.panel.rotation.handle
    until(lambda: np.allclose(position.value, 1e3 * before[:3, 3], atol=0.051))
    shown.page.change(position, [10.0, -20.0, 30.0])
    until(lambda: np.allclose(shown.controller.state.pose.T_object_root[:3, 3], [0.01, -0.02, 0.03]))
    # Turned by nothing, though its rotation is shown in tenths of a degree.
    assert shown.controller.state.pose.T_object_root[:3, :3].tolist() == before[:3, :3].tolist()
    shown.page.change(rotation, [0.0, 90.0, 0.0])
    turned = exp_so3(np.array([0.0, np.pi / 2, 0.0]))
    until(lambda: not np.allclose(shown.controller.state.pose.T_object_root[:3, :3], before[:3, :3]))
    np.testing.assert_allclose(shown.controller.state.pose.T_object_root[:3, :3], turned, atol=1e-12)
    until(lambda: rotation.value == (0.0, 90.0, 0.0))


def test_only_one_thing_has_a_gizmo(shown: Shown):
    hand, thing = (shown.panel.gizmos[what].handle for what in ("hand", "object"))
    shown.page.change(hand, True)
    until(lambda: shown.controller.state.gizmo == "hand")
    shown.page.change(thing, True)
    until(lambda: shown.controller.state.gizmo == "object")
    until(lambda: not hand.value and thing.value)
    shown.page.change(thing, False)
    until(lambda: shown.controller.state.gizmo == "none")


def test_targets_are_set_listed_and_deleted(shown: Shown):
    text, delete = shown.panel.targets, shown.panel.delete
    until(lambda: text.content)
    without = text.content
    shown.page.change(shown.panel.picking.handle, True)
    until(lambda: text.content != without)
    assert TIP not in text.content
    shown.controller.targets.pick_link(TIP, np.zeros(3))
    until(lambda: TIP in text.content)
    shown.controller.targets.pick_object(np.array([0.01, 0.02, 0.03]))
    until(lambda: f"| {TIP} |" in text.content and "| 10, 20, 30 |" in text.content)
    until(lambda: delete.visible and delete.options == (TIP,))
    shown.page.change(delete, TIP)
    until(lambda: shown.controller.state.targets == ())
    until(lambda: not delete.visible)
    shown.press("nearest")
    until(lambda: len(shown.controller.state.targets) > 1)
    until(lambda: len(delete.options) == len(shown.controller.state.targets))
    shown.press("auto")
    until(lambda: shown.controller.state.targets == ())
    shown.press("reset")
    until(lambda: shown.controller.state.pose.q.tolist() == shown.controller.state.initial.q.tolist())


def test_another_hand_has_other_sliders(shown: Shown, tmp_path: Path):
    (tmp_path / "plates.urdf").write_text(URDF)
    inputs = Inputs(hand=str(tmp_path / "plates.urdf"), object="sphere:0.03", grasps=Path("sample:1"))
    first = shown.sliders[0]
    shown.controller.grasps.open(Collection.of(load_problem(inputs)))
    until(lambda: [slider.label for slider in shown.sliders] == ["l", "r"])
    assert first._impl.removed
    assert (shown.sliders[0].min, shown.sliders[0].max) == (0.0, 70.0)
    shown.page.change(shown.sliders[1], -12.5)
    until(lambda: abs(shown.q[1] + 0.0125) < 1e-9)


def test_the_list_of_targets_reports_the_error_of_the_heading(problem: Problem):
    """The list measured between the points of a target, the heading from the points where link and object are near."""
    made = controller(problem)
    made.targets.set_nearest()
    settled(made)
    targets = made.state.targets
    moved = replace(targets[0], point_object=targets[0].point_object + np.array([0.003, 0.0, 0.004]))
    state = made.state.evolve(targets=(moved, *targets[1:]))
    found = made.contacts(state)
    text = targets_text(state, found)
    assert f"| {moved.link} | {1e3 * found.contact_error:.2f} |" in text and found.contact_error > 4e-3
    assert len([line for line in text.splitlines() if line.startswith("| ")]) == len(targets) + 1
    made.close()


def test_sliders_without_end_and_in_millimetres(tmp_path: Path):
    turning = URDF.replace('name="r" type="prismatic"', 'name="r" type="continuous"').replace(
        '<limit lower="-0.07" upper="0" effort="1" velocity="1"/>', ""
    )
    (tmp_path / "turning.urdf").write_text(turning)
    hand = load_hand(tmp_path / "turning.urdf")
    np.testing.assert_allclose(units(hand), [1e3, 180.0 / np.pi])
    np.testing.assert_allclose(limits(hand, 0, 1e3), (0.0, 70.0))
    assert limits(hand, 1, 180.0 / np.pi) == (-180.0, 180.0)


def test_regions_are_applied_as_they_were_written_and_shown_as_they_are(shown: Shown):
    regions = shown.panel.regions
    shown.page.change(regions.touch, "above:z=0.02; below:z=0.01")
    shown.page.change(regions.avoid, "above:z=0.08")
    shown.page.change(regions.apply, True)
    until(lambda: shown.controller.state.scene.regions is not None)
    found = shown.controller.state.scene.regions
    assert [one.spec for one in found.touch] == ["above:z=0.02", "below:z=0.01"]
    assert [one.spec for one in found.avoid] == ["above:z=0.08"]
    until(lambda: not regions.clear.disabled)  # the page shows them
    shown.press("undo")
    until(lambda: regions.touch.value == regions.avoid.value == "" and regions.clear.disabled)
    assert shown.controller.state.scene.regions is None
    shown.press("redo")
    until(lambda: regions.avoid.value == "above:z=0.08")
    shown.page.change(regions.clear, True)
    until(lambda: shown.controller.state.scene.regions is None)
    shown.page.change(regions.brush, "touch")
    until(lambda: shown.controller.state.brush == "touch" and regions.advice.visible)
