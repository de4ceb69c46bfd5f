"""Depth pictures with their masks, cameras and poses: files and texts as cameras and robots write them."""

from __future__ import annotations

import json
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from grasp_refine.core.arguments import as_numbers
from grasp_refine.core.array_types import Bool, Float
from grasp_refine.core.errors import GraspRefineError, MeshError
from grasp_refine.core.names import is_file
from grasp_refine.core.npz_files import MAGIC, MAX_HEADER_BYTES, array_header
from grasp_refine.core.rpy_poses import read_pose
from grasp_refine.core.se3 import is_rigid

PICTURES = (".png", ".tif", ".tiff")
"""Suffixes of depth pictures."""

MILLIMETRES = 0.001
"""Metres in a step of a depth picture of integers, as the cameras of most makers write them."""

MAX_PIXELS = 2**24
"""Most pixels of all pictures of a file together."""

MAX_ARRAY_BYTES = 2**29
"""Most bytes of an array file: 512 MiB."""

MAX_NUMBERS = 16 * 64
"""Most numbers that intrinsics and poses may have; aliases in YAML make small files large."""

MAX_TEXT_BYTES = 2**16
"""Most bytes of a file of numbers."""


def read_array(path: Path) -> np.ndarray:
    """Return the array of an `.npy` file without pickle.

    Raises:
        MeshError: it is damaged, or too large.
    """
    try:
        with path.open("rb") as file, warnings.catch_warnings():
            warnings.simplefilter("ignore")  # about headers from Python 2
            head = file.read(MAX_HEADER_BYTES)
            shape, kind, start = array_header(head) if head.startswith(MAGIC) else ((), np.dtype("O"), 0)
            needed = int(np.prod(shape, dtype=object)) * kind.itemsize + start
            if kind.kind not in "biuf" or needed > path.stat().st_size:
                raise ValueError("not an array of numbers, or cut off")
            if needed > MAX_ARRAY_BYTES:
                raise ValueError(f"{needed} bytes; at most {MAX_ARRAY_BYTES} are read")
            file.seek(0)
            return np.load(file, allow_pickle=False, mmap_mode=None)
    except (OSError, ValueError, EOFError) as error:
        raise MeshError(f"{path}: cannot be read as an array ({error})") from None


def read_picture(path: Path) -> np.ndarray:
    """Return the values (H, W) of a picture, 16 bits where it has them; of colours the first channel.

    Raises:
        MeshError: it is damaged, or too large.
    """
    from PIL import Image, UnidentifiedImageError

    if path.suffix.lower() == ".npy":
        return read_array(path)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # about damage
            picture = Image.open(path, formats=("PNG", "TIFF", "JPEG", "BMP"))
            with picture:
                if picture.width * picture.height > MAX_PIXELS:
                    raise MeshError(
                        f"{path}: has {picture.width} x {picture.height} pixels; at most {MAX_PIXELS} are read"
                    )
                values = np.asarray(picture)
    except (OSError, ValueError, SyntaxError, UnidentifiedImageError, Image.DecompressionBombError) as error:
        raise MeshError(f"{path}: cannot be read as a picture ({error})") from None
    return values if values.ndim == 2 else values[..., 0]


def depth_in_metres(values: np.ndarray, name: object) -> Float[np.ndarray, "*v H W"]:
    """Return depth pictures in metres: integers are millimetres.

    Raises:
        MeshError: they are of 8 bits, or no pictures.
    """
    values = _without_channel(values)
    if values.size > MAX_PIXELS:
        raise MeshError(f"{name}: has {values.size} pixels; at most {MAX_PIXELS} are read: cut the object out")
    if values.ndim not in (2, 3) or not values.size or values.dtype.kind not in "uif" or values.dtype.itemsize < 2:
        raise MeshError(
            f"{name}: is no depth picture: {values.dtype} of shape {values.shape}; 16-bit integers in millimetres or "
            "floats in metres are"
        )
    with np.errstate(invalid="ignore"):  # NaN of many kinds
        return values.astype(np.float64) * (1.0 if values.dtype.kind == "f" else MILLIMETRES)


def as_mask(value: Any, shape: tuple[int, ...], name: str) -> Bool[np.ndarray, "*v H W"]:
    """Return a mask of the shape of a depth picture, from a picture or an array: 0 is outside.

    Raises:
        MeshError: it has another shape, or no pixel of the object.
    """
    mask = read_picture(_existing(value, "mask")) if isinstance(value, str | Path) else np.asarray(value)
    mask = _without_channel(mask)
    if mask.shape != shape:
        raise MeshError(f"{name}: its mask has shape {mask.shape}, the depth has {shape}")
    if not (mask := mask != 0).any():
        raise MeshError(f"{name}: its mask is empty")
    return mask


def _without_channel(values: np.ndarray) -> np.ndarray:
    """Return pictures without an axis of their one channel, (H, W, 1)."""
    return values[..., 0] if values.ndim > 2 and values.shape[-1] == 1 else values


def as_intrinsics(value: Any) -> Float[np.ndarray, " 4"]:
    """Return fx, fy, cx, cy in pixels, from a text of the four, a file, a matrix (3, 3), or an object with these.

    Files are JSON or YAML with fx, fy and cx, cy (or ppx, ppy; or _fx and so on, as autolab_core writes them),
    or with the matrix under K, k, cam_K, camera_matrix or intrinsic_matrix (of 9 numbers, by rows; by columns, as
    Open3D writes it); or `.npy` or text with 4 or 9 numbers.

    Raises:
        GraspRefineError: these are no intrinsics.
    """
    shown = value if isinstance(value, str | Path) else "intrinsics"
    numbers: Any = value
    if isinstance(value, str) and (parts := value.split(",")) and len(parts) == 4:
        numbers = parts
    elif isinstance(value, str | Path):
        numbers = _numbers(_existing(value, "intrinsics"))
    elif hasattr(value, "fx"):
        numbers = [getattr(value, name) for name in ("fx", "fy", "cx", "cy")]
    if isinstance(numbers, Mapping):
        numbers = _of_mapping(numbers)
    try:
        found = np.array(_flat(numbers), dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        found = np.zeros(0)
    if found.size == 9:
        matrix = found.reshape(3, 3)
        matrix = matrix.T if matrix[0, 2] == 0 and matrix[1, 2] == 0 else matrix
        found = np.array([matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2]])
    if found.size != 4 or not np.isfinite(found).all() or min(found[:2]) <= 0:
        raise GraspRefineError(
            f"{shown}: no intrinsics: fx, fy, cx, cy in pixels, as in 600,600,320,240, or a file of them or of the "
            "matrix (3, 3)"
        )
    return found


def as_poses(value: Any) -> Float[np.ndarray, "V 4 4"]:
    """Return poses (V, 4, 4) of cameras in the object's frame, of OpenCV's axes, from a text, a file or arrays.

    A text is x,y,z,roll,pitch,yaw in metres and degrees. Files are `.npy`, JSON or text with one matrix or several.

    Raises:
        GraspRefineError: these are no poses.
    """
    shown = value if isinstance(value, str | Path) else "camera"
    if isinstance(value, str) and len(value.split(",")) in (3, 6):
        return read_pose(value, "`camera`")[None]
    numbers: Any = _numbers(_existing(value, "camera")) if isinstance(value, str | Path) else value
    try:
        poses = np.array(_flat(numbers), dtype=np.float64).reshape(-1, 4, 4)
    except (TypeError, ValueError, OverflowError):
        poses = np.zeros((0, 4, 4))
    if not len(poses) or not is_rigid(poses).all():
        raise GraspRefineError(
            f"{shown}: no pose of a camera: a matrix (4, 4) that takes coordinates of the camera (x right, y down, z "
            "forward, metres) to the object's frame, or x,y,z,roll,pitch,yaw"
        )
    return poses


def as_positions(value: Any) -> Float[np.ndarray, "V 3"]:
    """Return positions (V, 3) in metres from texts x,y,z, or an array of one or several.

    Raises:
        GraspRefineError: these are no positions.
    """
    texts = [value] if isinstance(value, str) else value
    if isinstance(texts, tuple | list) and texts and all(isinstance(text, str) for text in texts):
        try:
            value = [[float(part) for part in text.split(",")] for text in texts]
        except ValueError:
            value = None
    try:
        found = as_numbers("seen_from", value)
    except GraspRefineError:
        found = np.zeros(0)
    found = found[None] if found.shape == (3,) else found
    if found.ndim != 2 or found.shape[1] != 3 or not len(found) or not np.isfinite(found).all():
        shown = ", ".join(map(str, texts)) if isinstance(texts, tuple | list) else texts
        raise GraspRefineError(f"`seen_from`: the position of a sensor is x,y,z in metres, as in 0,0,0.5; got {shown}")
    return found


def _flat(numbers: Any) -> list[Any]:
    """Return the numbers in nested lists, or an array.

    Raises:
        ValueError: there are more than `MAX_NUMBERS`.
    """
    if hasattr(numbers, "shape") or hasattr(numbers, "__array__"):
        numbers = np.asarray(numbers).ravel()[: MAX_NUMBERS + 1].tolist()
    found, waiting = list[Any](), [numbers]
    for _ in range(2 * MAX_NUMBERS):
        if not waiting:
            return found
        one = waiting.pop()
        if isinstance(one, list | tuple):
            waiting += reversed(one[: MAX_NUMBERS + 1])
        else:
            found.append(one)
    raise ValueError(f"more than {MAX_NUMBERS} numbers")


def _existing(value: str | Path, what: str) -> Path:
    path = Path(value)
    if not is_file(path):
        raise GraspRefineError(f"`{what}={value}`: no such file")
    return path


def _numbers(path: Path) -> Any:
    """Return the content of a file of numbers.

    Raises:
        GraspRefineError: it cannot be read.
    """
    import yaml

    suffix = path.suffix.lower()
    if suffix == ".npy":
        return read_array(path)
    if path.stat().st_size > MAX_TEXT_BYTES:
        raise GraspRefineError(f"{path}: too large for a few numbers; at most {MAX_TEXT_BYTES} bytes are read")
    try:
        text = path.read_text(encoding="utf-8")
        if suffix == ".json" or text.lstrip().startswith("{"):
            return json.loads(text)
        if suffix in (".yaml", ".yml"):
            return yaml.safe_load(text)
        return [float(word) for word in text.replace(",", " ").split()]
    except (OSError, ValueError, RecursionError, yaml.YAMLError) as error:
        raise GraspRefineError(f"{path}: cannot be read as numbers ({' '.join(str(error).split())[:120]})") from None


def _of_mapping(found: Mapping[Any, Any]) -> Any:
    """Return the intrinsics in a mapping: four numbers, or the matrix."""
    found = {str(name).removeprefix("_"): value for name, value in found.items()}
    for names in (("fx", "fy", "cx", "cy"), ("fx", "fy", "ppx", "ppy")):
        if all(name in found for name in names):
            return [found[name] for name in names]
    for name in ("K", "k", "cam_K", "camera_matrix", "intrinsic_matrix", "intrinsics"):
        inner = found.get(name)
        if isinstance(inner, Mapping):
            return inner["data"] if "data" in inner else _of_mapping(inner)
        if inner is not None:
            return inner
    return None
