"""Completions of a scan by other programs: a folder of meshes, each a solid that the object may be."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from grasp_refine.core.errors import MeshError
from grasp_refine.core.names import is_folder
from grasp_refine.core.plurals import count_text
from grasp_refine.core.toml_file import UNREADABLE, read_toml
from grasp_refine.geometry.decomposition import Decomposition
from grasp_refine.geometry.mesh import SUFFIXES, Holes, load_mesh, watertight
from grasp_refine.geometry.pieces import cut_meshes
from grasp_refine.scans.hypothesis import Hypothesis

WEIGHTS = "weights.toml"
"""File of lines `"mesh" = 0.3` in the folder, with the name of each mesh file without its suffix; none: equal weights.
"""

GIVEN = "given"
"""Kind of hypotheses of other programs."""

MAX_COMPLETIONS = 64
"""Most meshes of a folder."""


def given_completions(
    folder: Path,
    *,
    scale: float = 1.0,
    holes: Holes = "refuse",
    decomposition: Decomposition | None = None,
    cache: Path | None = None,
) -> tuple[tuple[Hypothesis, ...], tuple[str, ...]]:
    """Return the hypotheses that the meshes in a folder are, the most probable first, and notes on their repairs.

    Args:
        folder: Meshes in the frame of the object.
        scale: Factor that takes them to metres.
        holes: Treatment of meshes with holes.
        decomposition: Settings for cutting them into convex pieces.
        cache: Folder of earlier decompositions; None: no cache.

    Raises:
        MeshError: there are none, or more than `MAX_COMPLETIONS`; one cannot be used; or the weights do not fit.
    """
    if not is_folder(folder):
        raise MeshError(f"{folder}: no such folder of completions")
    files = sorted(file for file in folder.iterdir() if file.suffix.lower() in SUFFIXES)
    if not 0 < len(files) <= MAX_COMPLETIONS:
        raise MeshError(
            f"{folder}: has {count_text(len(files), 'mesh', 'meshes')} ({', '.join(SUFFIXES)}); completions are 1 to "
            f"{MAX_COMPLETIONS}"
        )
    weights = _weights(folder, [file.stem for file in files])
    meshes, notes = [], list[str]()
    for file in files:
        mesh, repairs = watertight(load_mesh(file, scale), file.name, holes)
        meshes.append((file.name, mesh))
        notes += repairs
    cuts = cut_meshes(meshes, decomposition, cache=cache)
    order = np.argsort(-weights, kind="stable")
    return tuple(Hypothesis(GIVEN, tuple(cuts[at].pieces), float(weights[at])) for at in order), tuple(notes)


def _weights(folder: Path, names: list[str]) -> np.ndarray:
    """Return the probability of each mesh."""
    path = folder / WEIGHTS
    if not path.is_file():
        return np.full(len(names), 1 / len(names))
    try:
        found = read_toml(path)
    except UNREADABLE as error:
        raise MeshError(f"{path}: cannot be read as lines mesh = weight ({error})") from None
    if set(found) != set(names):
        odd = sorted(set(found) ^ set(names))
        raise MeshError(f"{path}: must have one weight for each mesh beside it; {', '.join(odd)} is only here or there")
    weights = [found[name] for name in names]
    if not all(isinstance(weight, int | float) and 0 <= weight < np.inf for weight in weights) or not sum(weights) > 0:
        raise MeshError(f"{path}: weights must be 0 or more, and one of them above 0")
    return np.array(weights, dtype=np.float64) / sum(weights)
