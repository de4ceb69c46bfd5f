"""Films of a replay: the simulated shapes, their contacts, the push, and a caption, from a side that shows them."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import trimesh
from PIL import Image, ImageDraw

from grasp_refine.core.atomic_files import written_whole
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.plurals import count_text
from grasp_refine.core.se3 import transform
from grasp_refine.validation.replay.replay import OBJECT, Replay, Stage, check_replay, object_contacts
from grasp_refine_apps.report.drawing import BAD, GOOD, GREY, INK, LINK_COLOR, OBJECT_COLOR, best_side, font, photograph
from grasp_refine_apps.report.rasterizer import Camera, Model

OVERSAMPLING = 1.5
"""Factor by which pictures are drawn larger, then averaged for smooth edges."""
OBJECT_OPACITY = 0.82
"""Opacity of the object, through which fingers behind it are visible."""
OTHER_COLOR, FORCE_COLOR = (0.86, 0.88, 0.87), (0.78, 0.08, 0.16)
"""Colours of the table and of the push."""
CONTACT = "#1565d8"
"""Colour of contact points."""
TABLE_SIZE_M = 0.25
"""Half of the side of the part of a plane that is drawn."""
FOLLOWED_DISTANCE_M, SHOWN_DISTANCE_M = 0.1, 0.2
"""Displacement of the object (metres) above which the camera no longer follows it, and above which it is not shown."""


def film(
    model: mujoco.MjModel, replay: Replay, path: str | Path, size: tuple[int, int] = (480, 400), rate: float = 20.0
) -> int:
    """Save a replay as a film that loops (.gif), and return its number of pictures.

    It ends where the object, if it is lost, is out of sight.

    Args:
        model: Model of the simulation.
        replay: Recording of the model.
        path: File to write.
        size: Width and height in pixels, the caption included.
        rate: Pictures per second.

    Raises:
        GraspRefineError: The replay is of another model, or the file cannot be written.
    """
    check_replay(model, replay)
    moved, _ = replay.displacement()
    end = replay.time[last_in_sight(replay)]
    wanted = np.append(np.arange(replay.time[0], end - 1e-9, 1.0 / rate), end)
    frames = np.clip(np.searchsorted(replay.time, wanted - 1e-9), 0, len(replay) - 1)
    scenes = Shapes(model, replay)
    followed = frames[moved[frames] < FOLLOWED_DISTANCE_M]
    camera = scenes.camera(followed[:: max(len(followed) // 8, 1)], size)
    images = [scenes.picture(int(frame), camera, size) for frame in frames]
    # The last picture stays for a second.
    durations = [round(1000 / rate)] * (len(images) - 1) + [1000]
    with written_whole(Path(path)) as partial:
        images = _with_palette(images)
        images[0].save(partial, "GIF", save_all=True, append_images=images[1:], duration=durations, loop=0)
    return len(images)


def last_in_sight(replay: Replay) -> int:
    """Return the last frame before the object is lost, or the last of all."""
    lost = replay.displacement()[0] > SHOWN_DISTANCE_M
    return max(int(lost.argmax()) - 1, 0) if lost.any() else len(replay) - 1


class Shapes:
    """Simulated shapes of a replay, body by body."""

    def __init__(self, model: mujoco.MjModel, replay: Replay) -> None:
        """Take the shapes that can touch."""
        self.model, self.replay = model, replay
        self._data = mujoco.MjData(model)
        solid = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
        self._bodies: dict[int, Model] = {}
        self._object = model.body(OBJECT).id
        for body in np.unique(model.geom_bodyid[solid]).tolist():
            meshes = [geom_mesh(model, geom) for geom in np.flatnonzero(solid & (model.geom_bodyid == body)).tolist()]
            color = OBJECT_COLOR if body == self._object else LINK_COLOR if model.body_weldid[body] else OTHER_COLOR
            opacity = OBJECT_OPACITY if body == self._object else 1.0
            self._bodies[body] = Model.of(meshes, color, opacity=opacity)

    def pose(self, frame: int) -> tuple[list[Model], list[Model], list[Model]]:
        """Set the state of a frame; return object, hand, and what belongs to neither, in the world frame."""
        data = self._data
        self.replay.set_frame(data, frame)
        mujoco.mj_fwdPosition(self.model, data)
        groups: tuple[list[Model], list[Model], list[Model]] = [], [], []
        for body, shape in self._bodies.items():
            T = transform(data.xmat[body].reshape(3, 3), data.xpos[body])
            group = 0 if body == self._object else 1 if self.model.body_weldid[body] else 2
            groups[group].append(shape.moved(T))
        return groups

    def camera(self, frames: np.ndarray, size: tuple[int, int]) -> Camera:
        """Return the camera of a picture of that size from which most of hand and object is seen in the frames."""
        seen = [self.pose(int(frame)) for frame in frames]
        shown = [model for obj, hand, _ in seen for model in (*obj, *hand)]
        points = np.concatenate([model.vertices for model in (*shown, *self._arrow(int(frames[-1])))])
        width, height = round(OVERSAMPLING * size[0]), round(OVERSAMPLING * (size[1] - _caption_height(size)))
        push = self.replay.force / max(float(np.linalg.norm(self.replay.force)), 1e-12)
        side = best_side(seen[-1], points, width / height, push if push.any() else None, above=bool(seen[-1][2]))
        return Camera.fitted(side, points, width, height, margin=0.16)

    def picture(self, frame: int, camera: Camera, size: tuple[int, int]) -> Image.Image:
        """Draw a frame with its caption."""
        obj, hand, others = self.pose(frame)
        photo = photograph([*obj, *hand, *others, *self._arrow(frame)], camera)
        contacts = object_contacts(self.model, self._data)
        draw, r = ImageDraw.Draw(photo), max(photo.height / 140, 3.0)
        for x, y in camera.project(contacts)[:, :2]:
            draw.ellipse([x - r, y - r, x + r, y + r], fill=CONTACT, outline="white", width=max(round(r / 3), 1))
        page, height = Image.new("RGB", size), _caption_height(size)
        page.paste(photo.resize((size[0], size[1] - height), Image.Resampling.HAMMING))
        page.paste(
            caption((2 * size[0], 2 * height), self.replay, frame, len(contacts)).reduce(2), (0, size[1] - height)
        )
        return page

    def _arrow(self, frame: int) -> list[Model]:
        """Return the arrow of the push, from the object's centre outwards, where it acts."""
        force = self.replay.force
        if self.replay.stage[frame] != Stage.PUSH or not np.any(force):
            return []
        reach = float(np.linalg.norm(self._bodies[self._object].vertices - self.model.body(OBJECT).ipos, axis=1).max())
        length = 0.8 * reach + 0.03
        shaft = trimesh.creation.cylinder(0.05 * reach, length, sections=16)
        shaft.apply_translation([0.0, 0.0, 0.5 * length])
        head = trimesh.creation.cone(0.12 * reach, 0.4 * reach, sections=16)
        head.apply_translation([0.0, 0.0, length])
        T = trimesh.geometry.align_vectors([0.0, 0.0, 1.0], force)
        T[:3, 3] = self._data.body(OBJECT).xipos
        return [Model.of([shaft, head], FORCE_COLOR).moved(T)]


def geom_mesh(model: mujoco.MjModel, geom: int) -> trimesh.Trimesh:
    """Return the surface of a geom in the frame of its body; of a plane, a part of it."""
    kind, size = mujoco.mjtGeom(model.geom_type[geom]), model.geom_size[geom]
    if kind == mujoco.mjtGeom.mjGEOM_MESH:
        number = model.geom_dataid[geom]
        begin, face = model.mesh_vertadr[number], model.mesh_faceadr[number]
        vertices = model.mesh_vert[begin : begin + model.mesh_vertnum[number]]
        mesh = trimesh.Trimesh(vertices, model.mesh_face[face : face + model.mesh_facenum[number]], process=False)
    elif kind == mujoco.mjtGeom.mjGEOM_BOX:
        mesh = trimesh.creation.box(2 * size)
    elif kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
        mesh = trimesh.creation.capsule(2 * size[1], size[0])
    elif kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        mesh = trimesh.creation.cylinder(size[0], 2 * size[1])
    elif kind == mujoco.mjtGeom.mjGEOM_PLANE:
        mesh = trimesh.creation.box([2 * TABLE_SIZE_M, 2 * TABLE_SIZE_M, 1e-4])
        mesh.apply_translation([0.0, 0.0, -0.5e-4])
    elif kind in (mujoco.mjtGeom.mjGEOM_SPHERE, mujoco.mjtGeom.mjGEOM_ELLIPSOID):
        mesh = trimesh.creation.icosphere(subdivisions=3)
        mesh.apply_scale(size if kind == mujoco.mjtGeom.mjGEOM_ELLIPSOID else size[0])
    else:
        raise GraspRefineError(f"no film: geom {model.geom(geom).name or geom} is of a type that is not drawn")
    turn = np.zeros(9)
    mujoco.mju_quat2Mat(turn, model.geom_quat[geom])
    return mesh.apply_transform(transform(turn.reshape(3, 3), model.geom_pos[geom]))


def state_of(replay: Replay, frame: int, contacts: int) -> str:
    """Return text on the stage of a frame, the displacement of the object and its number of contacts."""
    moved, turned = (float(values[frame]) for values in replay.displacement())
    distance = f"{1e3 * moved:.1f} mm" if moved < 1 else f"{moved:.1f} m"
    lift = 1e3 * float(np.linalg.norm(replay.lifted()[frame]))
    done = {
        Stage.CLOSE: f"closing: moved {distance}",
        Stage.SQUEEZE: f"squeezing: moved {distance}",
        Stage.PUSH: f"pushed {replay.direction}: moved {distance}",
        Stage.LIFT: f"hand lifted {lift:.1f} mm: object {distance} off",
    }[Stage(int(replay.stage[frame]))]
    return f"{replay.time[frame]:.2f} s, {done}, turned {np.degrees(turned):.1f}°, {count_text(contacts, 'contact')}"


def caption(size: tuple[int, int], replay: Replay, frame: int, contacts: int) -> Image.Image:
    """Return the caption below the picture of a frame.

    Args:
        size: Width and height in pixels.
        replay: Replay in the picture.
        frame: Number of the frame.
        contacts: Number of contact points of the object.
    """
    page = Image.new("RGB", size, "#ffffff")
    draw, (width, height) = ImageDraw.Draw(page), size
    margin, line = round(0.02 * width), height / 2.3
    title = f"{replay.name}, {replay.hand}, {replay.direction}, {replay.protocol}"
    state = state_of(replay, frame, contacts)
    color = GOOD if replay.reason == "held" else BAD
    verdict = font(0.62 * line, replay.reason, 0.25 * width)
    draw.text((width - margin, 0.62 * line), replay.reason, fill=color, font=verdict, anchor="rm")
    full = width - 2 * margin
    left = full - draw.textlength(replay.reason, font=verdict) - margin
    draw.text((margin, 0.62 * line), title, fill=INK, font=font(0.62 * line, title, left), anchor="lm")
    draw.text((margin, 1.55 * line), state, fill=GREY, font=font(0.55 * line, state, full), anchor="lm")
    return page


def _caption_height(size: tuple[int, int]) -> int:
    return max(round(0.11 * size[1]), 44)


def _with_palette(images: list[Image.Image]) -> list[Image.Image]:
    """Reduce pictures to 256 colours, for all the same, or they flicker; no dithering, which doubles the file."""
    width, height = images[0].size
    sample = Image.new("RGB", (width, 4 * height))
    for number in range(4):
        sample.paste(images[number * (len(images) - 1) // 3], (0, number * height))
    force = tuple(round(255 * part) for part in FORCE_COLOR)
    colors: tuple[str | tuple[int, ...], ...] = (CONTACT, GOOD, BAD, force)
    for number, color in enumerate(colors):
        # Small details have too few pixels to get a colour of their own.
        sample.paste(color, (24 * number, 0, 24 * number + 24, 24))
    palette = sample.quantize(256, dither=Image.Dither.NONE)
    return [image.quantize(palette=palette, dither=Image.Dither.NONE) for image in images]
