"""The HTML of a film: one small file that asks for nothing, and plays in a browser from disk."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from browser import ViserPage, until
from grasp_refine.scene.scene import Scene
from grasp_refine_apps.viewer.drawing.camera import FirstCamera
from grasp_refine_apps.viewer.drawing.shapes import LinkPoses, visual_shapes
from grasp_refine_apps.viewer.files.animation import Film, Frame, animation_html
from grasp_refine_apps.viewer.model.pose import Pose
from open_viewer import example

STEPS = 11


@pytest.fixture(scope="module")
def scene() -> Scene:
    return example().groups[0].scene


@pytest.fixture(scope="module")
def film(scene: Scene) -> Film:
    """The embedded hand goes up by 10 cm while the object goes down by 5 cm."""
    T, q = scene.T_world_root[0], scene.q[0]
    frames = []
    for k in range(STEPS):
        up, down = np.eye(4), np.eye(4)
        up[2, 3], down[2, 3] = 0.1 * k / (STEPS - 1), -0.05 * k / (STEPS - 1)
        line = np.array([[[0.0, 0.0, 0.0], [0.0, 0.0, 0.2]]])
        lines = (line, np.array([[200, 0, 200]], dtype=np.uint8)) if k else ()
        frames.append(Frame(Pose(up @ T, q), f"step {k} < {STEPS}", *lines, T_object=down))
    camera = FirstCamera(np.array([0.0, -0.7, 0.2]), np.array([0.0, 0.0, 0.05]))
    return Film("a <hand> & a mug", scene.hand, scene.object, frames, camera)


@pytest.fixture(scope="module")
def page(film: Film) -> str:
    return animation_html(film, seconds=2.0)


def test_the_file_is_small_and_names_what_it_shows(page: str):
    assert len(page) < 2e6
    assert "<title>a &lt;hand&gt; &amp; a mug</title>" in page
    assert "<b>a &lt;hand&gt; &amp; a mug</b>" in page


@pytest.mark.slow
def test_it_plays_from_disk_again_and_again(film: Film, page: str, tmp_path: Path, open_page: Callable[..., ViserPage]):
    file = tmp_path / "film.html"
    file.write_text(page, encoding="utf-8")
    # Small: what is drawn without a graphics card takes its time.
    opened = open_page(file.as_uri(), size=(480, 360))
    shapes, poses = visual_shapes(film.hand), LinkPoses.of(film.hand)
    last = len(shapes) - 1
    opened.wait_for_node(f"/hand/{last}")
    opened.wait_for_scene()

    first = film.frames[0].pose
    T = poses(first.T_object_root, first.q)
    x, y, z = T[shapes[last].link][:3, 3]
    hand, mug, captions = [], [], set()

    def seen() -> bool:
        hand.append(opened.pose(f"/hand/{last}")[:3, 3] - (x, y, z))
        mug.append(opened.pose("/object")[:3, 3])
        captions.add(opened.page.locator("#caption").inner_text())
        heights, lowered = (np.array(points)[:, 2] for points in (hand, mug))
        various = all(len(set(each.round(3))) >= number for each, number in ((heights, 4), (lowered, 3)))
        return various and bool((np.diff(heights) < -0.01).any()) and len(captions) >= 3

    until(seen, "the hand goes up, and begins again")
    np.testing.assert_allclose(np.array(hand)[:, :2], 0.0, atol=1e-5)
    assert -1e-6 < np.min(hand) and np.max(hand) < 0.1 + 1e-6
    assert -0.05 - 1e-6 < np.min(mug) and np.max(mug) < 1e-6
    assert captions <= {frame.caption for frame in film.frames} | {""}

    np.testing.assert_allclose(opened.pose("/ghost/0")[:3, 3], T[shapes[0].link][:3, 3], atol=1e-5)
    np.testing.assert_allclose(opened.camera()[:3, 3], film.camera.position, atol=1e-5)
    asked = {address.split("?")[0] for address in opened.requests if not address.startswith(("blob:", "data:"))}
    assert asked == {file.as_uri()}, "nothing is fetched"
