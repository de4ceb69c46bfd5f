"""Ground below hand and object, with their soft shadow, and the light that models form.

The shadow is a picture: browsers without a graphics card draw it at once, and exported pages have it, too.
"""

from __future__ import annotations

import numpy as np
import viser

from grasp_refine.core.array_types import Float, UInt8
from grasp_refine_apps.viewer.drawing.camera import ABOVE, UP, FirstCamera, slanted

SHADOW_PIXELS = 96
"""Pixels of the shadow's picture along each axis."""

BLUR_PIXELS = 4.0
"""Standard deviation of the shadow's blur in pixels."""

DARKNESS = 0.26
"""Largest opacity of the shadow."""

SHADOW_MARGIN = 0.35
"""Share of the shadow's extent that is left free on each side, for the blur."""

CELL_M = 0.05
"""Side of the cells on the ground, metres."""

KEY_INTENSITY, FILL_INTENSITY = 2.5, 2.1
"""Intensities of the light that models form, from the upper left of the first camera, and of the light from all sides.
"""

SKY_COLOR, GROUND_COLOR = (255, 255, 255), (196, 202, 214)
"""Colours of the light from above and below."""


class Ground:
    """Ground and shadow, in the world frame."""

    def __init__(self, scene: viser.SceneApi, height: float, size: float, shadow_height: float) -> None:
        """Make the ground and the shadow at heights in metres; `size` is the extent of hand and object in metres."""
        self._scene, self._height = scene, shadow_height
        self.grid = scene.add_grid(
            "/ground/grid", infinite_grid=True, cell_size=CELL_M, section_size=4 * CELL_M, position=(0.0, 0.0, height),
            cell_color=(172, 176, 182), section_color=(150, 155, 163), cell_thickness=0.5, section_thickness=0.6,
            fade_distance=5.0 * size, fade_strength=1.5, fade_from="origin", shadow_opacity=0.0,
        )  # fmt: skip
        self._shadow: viser.ImageHandle | None = None

    def draw(self, points: Float[np.ndarray, "N 3"]) -> None:
        """Draw the shadow of hand and object, points (N, 3) all over them, world frame."""
        image, middle, side = shadow(points)
        place = (float(middle[0]), float(middle[1]), self._height + 2e-4)
        if self._shadow is None:
            # An image looks along its own z axis, its rows go along y.
            self._shadow = self._scene.add_image(
                "/ground/shadow", image, side, side, format="png", cast_shadow=False, receive_shadow=False,
                wxyz=(0.0, 1.0, 0.0, 0.0), position=place,
            )  # fmt: skip
            return
        self._shadow.image = image
        self._shadow.render_width = self._shadow.render_height = side
        self._shadow.position = place

    def show_shadow(self, visible: bool) -> None:
        """Show or hide the shadow, which hides what is below it in a body that is seen through."""
        if self._shadow is not None:
            self._shadow.visible = visible

    def remove(self) -> None:
        """Remove ground and shadow."""
        self.grid.remove()
        if self._shadow is not None:
            self._shadow.remove()


def shadow(points: Float[np.ndarray, "N 3"]) -> tuple[UInt8[np.ndarray, "H W 4"], Float[np.ndarray, " 2"], float]:
    """Return the soft shadow of points on a level ground: picture, middle (2,) and side in metres.

    Rows of the picture go along y, columns along x.
    """
    low, high = points[:, :2].min(axis=0), points[:, :2].max(axis=0)
    middle, side = (low + high) / 2, float((high - low).max() * (1 + 2 * SHADOW_MARGIN)) + 1e-6
    edges = np.linspace(-side / 2, side / 2, SHADOW_PIXELS + 1)
    x, y = (points[:, :2] - middle).T
    covered = np.histogram2d(y, x, (edges, edges))[0] > 0
    # Points are spread over surfaces, with gaps between them.
    dark = _blurred(np.minimum(2.5 * _blurred(covered.astype(float), 1.2), 1.0), BLUR_PIXELS)
    image = np.zeros((SHADOW_PIXELS, SHADOW_PIXELS, 4), dtype=np.uint8)
    image[..., :3] = 20, 24, 38
    image[..., 3] = np.round(255 * DARKNESS * dark)
    return image, middle, side


def _blurred(image: Float[np.ndarray, "N N"], deviation: float) -> Float[np.ndarray, "N N"]:
    """Return a square picture blurred by a Gaussian of this standard deviation in pixels; it is 0 beyond its edges."""
    place = np.arange(len(image)) / deviation
    weight = np.exp(-0.5 * (place[:, None] - place) ** 2) / (np.sqrt(2.0 * np.pi) * deviation)
    return weight @ image @ weight


def light(scene: viser.SceneApi, camera: FirstCamera | None = None) -> None:
    """Light the scene from the upper left of a camera, and a little from all sides."""
    back = slanted(np.array(ABOVE) if camera is None else camera.position - camera.look_at)
    right = np.cross(UP, back)
    right /= np.linalg.norm(right)
    towards = 0.7 * back - 0.75 * right + 0.9 * np.array(UP)
    scene.configure_default_lights(False)
    scene.configure_environment_map(None)
    scene.add_light_directional("/light/key", intensity=KEY_INTENSITY, position=tuple(towards.tolist()))
    scene.add_light_hemisphere(
        "/light/fill", sky_color=SKY_COLOR, ground_color=GROUND_COLOR, intensity=FILL_INTENSITY, position=UP
    )
