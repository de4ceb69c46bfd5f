"""Rendering of a simulation: the shapes in our colours, their contacts, the push."""

from __future__ import annotations

import copy
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import product

import mujoco
import numpy as np
from jaxtyping import Bool, Float, UInt8
from PIL import Image, ImageDraw

from grasp_refine.core.errors import GraspRefineError
from grasp_refine.validation.replay.camera import FIELD_OF_VIEW, VIEWS, View
from grasp_refine.validation.replay.caption import write_caption
from grasp_refine.validation.replay.offscreen import offscreen_context
from grasp_refine.validation.replay.replay import OBJECT, Replay, Stage, check_replay

OVERSAMPLING = 2
"""Factor by which pictures are rendered larger and then averaged, for smooth edges."""
OBJECT_OPACITY = 0.82
"""Opacity of the object, through which fingers behind it are visible."""
CONTACT_GAP_M = 0.0005
"""Gap (metres) below which a contact is drawn."""

OBJECT_COLORS = ((0.96, 0.62, 0.27), (0.93, 0.55, 0.21), (0.98, 0.68, 0.35), (0.90, 0.50, 0.20))
HAND_COLORS = ((0.72, 0.74, 0.78), (0.62, 0.65, 0.70))
"""Colours of neighbouring pieces and links, which differ a little, to be distinguishable."""
OTHER_COLOR = (0.86, 0.88, 0.87)
FORCE_COLOR = (0.78, 0.08, 0.16)
SKY = ((248, 249, 252), (230, 234, 240))
"""Colours of the background at the top and at the bottom."""
PAPER, CONTACT = "#ffffff", "#1565d8"

_ALL = mujoco.mjtCatBit.mjCAT_ALL.value


@contextmanager
def studio(model: mujoco.MjModel, replay: Replay, size: tuple[int, int]) -> Iterator[Studio]:
    """Provide a `Studio` for pictures of that size in pixels; its context is freed afterwards.

    Raises:
        GraspRefineError: The replay is of another model, the size is out of range, or nothing here can render.
    """
    check_replay(model, replay)
    width, height = size
    caption = max(round(0.11 * height), 44)
    photo = width * OVERSAMPLING, (height - caption) * OVERSAMPLING
    if width < 200 or height < 160 or max(photo) > 8192:
        raise GraspRefineError(f"a picture of {width} x {height} pixels: at least 200 x 160, at most 4096 x 4096")
    recolored = _recolored(model, photo)
    context = offscreen_context(*photo)
    try:
        try:
            drawing = mujoco.MjrContext(recolored, mujoco.mjtFontScale.mjFONTSCALE_100.value)
        except mujoco.FatalError as error:
            raise GraspRefineError(f"no picture: MuJoCo cannot render with this OpenGL ({error})") from error
        try:
            mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN.value, drawing)
            drawing.readDepthMap = mujoco.mjtDepthMap.mjDEPTH_ZEROFAR
            yield Studio(recolored, replay, drawing, photo, (width, height))
        finally:
            drawing.free()
    finally:
        context.free()


def _recolored(model: mujoco.MjModel, photo: tuple[int, int]) -> mujoco.MjModel:
    """Return a copy in our colours, in which only geometry that can touch is visible."""
    model = copy.copy(model)
    solid = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    model.geom_matid[:] = -1
    model.geom_group[:] = np.where(solid, 0, 5)
    pieces = 0
    for geom, body in enumerate(model.geom_bodyid):
        if model.body(body).name == OBJECT:
            color = OBJECT_COLORS[pieces % len(OBJECT_COLORS)]
            pieces += 1
        elif model.body_weldid[body] == 0:
            color = OTHER_COLOR
        else:
            color = HAND_COLORS[body % len(HAND_COLORS)]
        model.geom_rgba[geom] = (*color, 1.0)
    # A table would be covered with the shadow of its own rounding errors.
    model.geom_castshadow[model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE] = 0
    model.vis.global_.offwidth, model.vis.global_.offheight = photo
    model.vis.global_.fovy = FIELD_OF_VIEW
    # Smooth edges come from drawing larger, which leaves a clear border between object and background.
    model.vis.quality.offsamples = 0
    model.vis.quality.shadowsize = 2048
    model.vis.headlight.active = 1
    model.vis.headlight.ambient[:] = 0.45
    model.vis.headlight.diffuse[:] = 0.30
    model.vis.headlight.specular[:] = 0.06
    # Clipping planes in metres; hands are well between.
    model.stat.extent = 1.0
    model.vis.map.znear, model.vis.map.zfar = 0.02, 20.0
    return model


class Studio:
    """Renderer of frames of one replay with one OpenGL context.

    `mujoco.Renderer` is not used: its kind of context is fixed when MuJoCo is imported, before a picture is requested.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        replay: Replay,
        drawing: mujoco.MjrContext,
        photo: tuple[int, int],
        size: tuple[int, int],
    ) -> None:
        """Take images of `photo` pixels for pictures of `size` pixels, captions included."""
        self.model, self.replay, self.frame = model, replay, 0
        self._drawing, self._photo, self._size = drawing, photo, size
        self._data = mujoco.MjData(model)
        self._scene = mujoco.MjvScene(model, model.ngeom + 100)
        self._option = mujoco.MjvOption()
        self._option.geomgroup[:] = [1, 0, 0, 0, 0, 0]
        self._option.sitegroup[:] = 0
        self._of_object = np.array([model.body(body).name == OBJECT for body in model.geom_bodyid])

    def pose(self, frame: int) -> None:
        """Set the state of a frame."""
        self.frame = range(len(self.replay))[frame]
        self._data.qpos[:] = self.replay.qpos[self.frame]
        self._data.mocap_pos[:] = self.replay.mocap_pos[self.frame]
        self._data.mocap_quat[:] = self.replay.mocap_quat[self.frame]
        mujoco.mj_fwdPosition(self.model, self._data)

    def corners(self) -> Float[np.ndarray, "n 3"]:
        """Return corners (n, 3) of boxes around all visible geometry of hand and object, world frame."""
        model, data = self.model, self._data
        seen = (model.geom_group == 0) & (model.geom_type != mujoco.mjtGeom.mjGEOM_PLANE)
        signs = np.array(list(product((-1.0, 1.0), repeat=3)))
        box = model.geom_aabb[seen]
        local = box[:, None, :3] + signs * box[:, None, 3:]
        turned = np.einsum("gij,gkj->gki", data.geom_xmat[seen].reshape(-1, 3, 3), local)
        return (turned + data.geom_xpos[seen, None]).reshape(-1, 3)

    def best_view(self, corners: Float[np.ndarray, "n 3"]) -> View:
        """Return the one of `VIEWS` that shows most of hand and object, far enough away to show all corners (n, 3)."""
        width, height = self._photo
        small = 96 * width // height, 96

        def score(view: View) -> float:
            owner = self._owners(view, small)
            shown = np.sqrt(np.mean(owner == 1) * np.mean(owner == 2))
            # People are used to looking down on things, and a push is seen best from the side.
            across = np.linalg.norm(np.cross(self._push(), view.axes()[2])) if np.any(self._push()) else 1.0
            return float(shown * (1.0 if view.elevation < 0 else 0.8) * (0.2 + 0.8 * across**2))

        return max((view.fit(corners, width / height) for view in VIEWS), key=score)

    def _push(self) -> Float[np.ndarray, " 3"]:
        """Return the unit direction of the push, or zero."""
        return self.replay.force / max(float(np.linalg.norm(self.replay.force)), 1e-12)

    def shoot(self, view: View) -> Image.Image:
        """Render the picture, with its caption."""
        solid = self._photograph(view, hidden=False)
        through = self._photograph(view, hidden=True)
        photo = OBJECT_OPACITY * solid + (1.0 - OBJECT_OPACITY) * through
        image = Image.fromarray(photo.round().astype(np.uint8))
        contacts = self._contacts()
        self._mark(ImageDraw.Draw(image), view.project(contacts, *self._photo))
        width, height = self._size
        page = Image.new("RGB", (OVERSAMPLING * width, OVERSAMPLING * height), PAPER)
        page.paste(image)
        write_caption(page, image.height, self.replay, self.frame, len(contacts))
        return page.reduce(OVERSAMPLING)

    def _aim(self, view: View, hidden: bool) -> None:
        """Fill the scene for a camera; with `hidden`, without the object."""
        camera = mujoco.MjvCamera()
        camera.type = mujoco.mjtCamera.mjCAMERA_FREE
        camera.azimuth, camera.elevation, camera.distance = view.azimuth, view.elevation, view.distance
        camera.lookat[:] = view.lookat
        self.model.geom_group[self._of_object] = 5 if hidden else 0
        mujoco.mjv_updateScene(self.model, self._data, self._option, None, camera, _ALL, self._scene)
        self.model.geom_group[self._of_object] = 0

    def _read(self, width: int, height: int) -> tuple[UInt8[np.ndarray, "h w 3"], Float[np.ndarray, "h w"]]:
        """Render the scene; return colours, and a depth that is 0 in the background."""
        colors, depth = np.empty((height, width, 3), np.uint8), np.empty((height, width), np.float32)
        area = mujoco.MjrRect(0, 0, width, height)
        mujoco.mjr_render(area, self._scene, self._drawing)
        mujoco.mjr_readPixels(colors, depth, area, self._drawing)
        return colors[::-1], depth[::-1]

    def _photograph(self, view: View, *, hidden: bool) -> Float[np.ndarray, "h w 3"]:
        """Render all bodies before the background, 0 to 255; with `hidden`, without the object."""
        self._aim(view, hidden)
        self._scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = not hidden
        # Half of the width that shadows are computed for, in metres: no more than is visible, for fine edges.
        self._drawing.shadowClip = view.distance * np.tan(np.radians(FIELD_OF_VIEW / 2)) * 1.4
        self._light(view)
        self._push_arrow()
        colors, depth = self._read(*self._photo)
        fade = np.linspace(0.0, 1.0, len(colors))[:, None, None]
        sky = (1.0 - fade) * np.array(SKY[0]) + fade * np.array(SKY[1])
        return np.where((depth > 0)[..., None], colors, sky)

    def _light(self, view: View) -> None:
        """Place one lamp above and to the left of the camera."""
        right, up, forward = view.axes()
        # The first is MuJoCo's at the camera; those of the model are left out.
        lamp, self._scene.nlight = self._scene.lights[1], 2
        place = -0.7 * right + 1.1 * up - 0.8 * forward
        lamp.headlight, lamp.castshadow = 0, 1
        lamp.type = mujoco.mjtLightType.mjLIGHT_DIRECTIONAL
        lamp.pos[:] = view.lookat + place
        lamp.dir[:] = -place / np.linalg.norm(place)
        lamp.ambient[:], lamp.diffuse[:], lamp.specular[:] = 0.0, 0.5, 0.12
        lamp.attenuation[:] = [1.0, 0.0, 0.0]

    def _push_arrow(self) -> None:
        """Add the arrow of the push, from the object's centre outwards."""
        if self.replay.stage[self.frame] != Stage.PUSH or not np.any(self.replay.force):
            return
        centre = self._data.body(OBJECT).xipos
        bodies = np.flatnonzero(self._of_object)
        reach = np.max(np.linalg.norm(self._data.geom_xpos[bodies] - centre, axis=1) + self.model.geom_rbound[bodies])
        arrow = self._scene.geoms[self._scene.ngeom]
        self._scene.ngeom += 1
        shape = mujoco.mjtGeom.mjGEOM_ARROW.value
        color = np.array([*FORCE_COLOR, 1.0], dtype=np.float32)
        mujoco.mjv_initGeom(arrow, shape, np.zeros(3), np.zeros(3), np.eye(3).ravel(), color)
        mujoco.mjv_connector(arrow, shape, 0.05 * reach, centre, centre + (reach + 0.04) * self._push())

    def _owners(self, view: View, size: tuple[int, int]) -> np.ndarray:
        """Return the owner of each pixel of a small picture: 0 background, 1 the object, 2 other bodies."""
        self._aim(view, hidden=False)
        flags = self._scene.flags
        flags[mujoco.mjtRndFlag.mjRND_SEGMENT] = flags[mujoco.mjtRndFlag.mjRND_IDCOLOR] = True
        colors, _ = self._read(*size)
        flags[mujoco.mjtRndFlag.mjRND_SEGMENT] = flags[mujoco.mjtRndFlag.mjRND_IDCOLOR] = False
        number = colors.astype(int) @ [1, 1 << 8, 1 << 16]
        owner = np.zeros(self._scene.ngeom + 1, dtype=int)
        for geom in self._scene.geoms[: self._scene.ngeom]:
            if geom.segid >= 0 and geom.objtype == mujoco.mjtObj.mjOBJ_GEOM:
                owner[geom.segid + 1] = 1 if self._of_object[geom.objid] else 2
        return owner[number]

    def _contacts(self) -> Float[np.ndarray, "n 3"]:
        """Return contact points of the object (n, 3), world frame."""
        contact = self._data.contact
        between: Bool[np.ndarray, " n"] = self._of_object[contact.geom].sum(axis=1) == 1
        return contact.pos[between & (contact.dist < CONTACT_GAP_M)].copy()

    def _mark(self, draw: ImageDraw.ImageDraw, points: Float[np.ndarray, "n 2"]) -> None:
        r = max(self._photo[1] / 140, 3.0)
        for x, y in points:
            draw.ellipse([x - r, y - r, x + r, y + r], fill=CONTACT, outline="white", width=max(round(r / 3), 1))
