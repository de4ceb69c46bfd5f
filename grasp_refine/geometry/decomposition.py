"""CoACD in a process of its own: some meshes crash the process that it runs in, and it cannot be interrupted."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from grasp_refine.core.errors import MeshError
from grasp_refine.core.interruption import end_with

POLL_INTERVAL_S = 0.1
"""Time between two checks for cancellation of a decomposition, in seconds."""

_RANGES = {
    "threshold": (0.01, 1),
    "preprocess_resolution": (20, 100),
    "resolution": (1000, 10000),
    "mcts_nodes": (10, 40),
    "mcts_iterations": (60, 2000),
    "mcts_max_depth": (2, 7),
    "seed": (0, 2**32 - 1),
}


@dataclass(frozen=True)
class Decomposition:
    """Settings of CoACD (Wei et al. 2022, collision-aware convex decomposition), with its own defaults."""

    threshold: float = 0.05
    """Largest concavity of a piece, 0.01 to 1, the mesh being 2 long: lower is finer, with more pieces."""
    max_pieces: int = -1
    """Most pieces, merged beyond the threshold if need be; -1: as many as the threshold takes."""
    preprocess: Literal["auto", "on", "off"] = "auto"
    """Remeshing with voxels first; auto: if the mesh has several parts or is not manifold."""
    preprocess_resolution: int = 50
    """Voxels along a side of that remeshing, 20 to 100."""
    resolution: int = 2000
    """Surface samples by which concavity is measured, 1000 to 10000."""
    mcts_nodes: int = 20
    """Candidate cutting planes per step of the tree search, 10 to 40."""
    mcts_iterations: int = 150
    """Iterations of the tree search for each cut, 60 to 2000."""
    mcts_max_depth: int = 3
    """Cuts that the tree search looks ahead, 2 to 7."""
    merge: bool = True
    """Whether pieces whose common hull stays below the threshold are merged again."""
    seed: int = 0
    """Seed of the search; same seed, same pieces."""

    def __post_init__(self) -> None:
        """Check the ranges of the settings.

        Raises:
            MeshError: a setting is outside its range.
        """
        for field, (low, high) in _RANGES.items():
            value = getattr(self, field)
            if not low <= value <= high:
                raise MeshError(f"decomposition: {field} must be {low:g} to {high:g}, got {value}")
        if not (self.max_pieces == -1 or self.max_pieces >= 1):
            raise MeshError(f"decomposition: max_pieces must be -1 (any) or at least 1, got {self.max_pieces}")


def decompose(
    vertices: np.ndarray,
    faces: np.ndarray,
    config: Decomposition,
    *,
    single: bool,
    threads: int | None = None,
    check: Callable[[], None] = lambda: None,
) -> list[np.ndarray]:
    """Return the corners (V, 3) of each part that CoACD cuts a mesh into.

    `single` is true for a mesh of one closed part. The number of `threads` (None: one for each core) does not change
    the parts. `check` is called every `POLL_INTERVAL_S`; an exception from it ends the decomposition.

    CoACD's own "auto" also remeshes where triangles of a single closed part cross. On scanned mugs and cans
    that took 3 to 7 times as long and made walls up to 50 % thicker, so it is the second attempt only.

    Raises:
        MeshError: CoACD ended without a result.
    """
    modes = ("off", "auto") if single and config.preprocess == "auto" else (config.preprocess,)
    for mode in modes:
        parts, fault = _run(vertices, faces, asdict(config) | {"preprocess": mode}, threads, check)
        if parts is not None:
            return parts
    raise MeshError(f"CoACD ended without a result ({fault})")


def _run(
    vertices: np.ndarray,
    faces: np.ndarray,
    settings: dict[str, float | str],
    threads: int | None,
    check: Callable[[], None],
) -> tuple[list[np.ndarray] | None, str]:
    """The parts, or None and the fault."""
    with tempfile.TemporaryDirectory(prefix="grasp-refine-") as folder:
        np.savez(Path(folder, "mesh.npz"), vertices=vertices, faces=faces)
        with _start(folder, settings, threads) as child:
            try:
                errors = _wait(child, check)
            except BaseException:
                child.kill()
                raise
        if child.returncode != 0:
            return None, ": ".join([f"exit code {child.returncode}", *errors.strip().splitlines()[-1:]])
        with np.load(Path(folder, "parts.npz"), allow_pickle=False) as arrays:
            return [arrays[f"arr_{index}"] for index in range(len(arrays.files))], ""


def _start(folder: str, settings: dict[str, float | str], threads: int | None) -> subprocess.Popen[str]:
    """Start the child process on `mesh.npz` of `folder`."""
    # The child imports from the same places as this process, also where the package is not installed.
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    return subprocess.Popen(
        [sys.executable, "-m", "grasp_refine.geometry.decomposition", folder, json.dumps(settings), str(os.getpid())],
        env=environment | ({} if threads is None else {"OMP_NUM_THREADS": str(threads)}),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        errors="replace",
    )


def _wait(child: subprocess.Popen[str], check: Callable[[], None]) -> str:
    """Wait for a child process to end, and return its error output."""
    while True:
        try:
            return child.communicate(timeout=POLL_INTERVAL_S)[1]
        except subprocess.TimeoutExpired:
            check()


def _main(folder: str, settings: str, parent: str) -> None:
    """Run the child process: `mesh.npz` of `folder` in, `parts.npz` out; ends with the process `parent`."""
    end_with(int(parent))
    import coacd

    coacd.set_log_level("error")
    options = json.loads(settings)
    options["max_convex_hull"] = options.pop("max_pieces")
    options["preprocess_mode"] = options.pop("preprocess")
    with np.load(Path(folder, "mesh.npz"), allow_pickle=False) as arrays:
        parts = coacd.run_coacd(coacd.Mesh(arrays["vertices"], arrays["faces"]), **options)
    np.savez(Path(folder, "parts.npz"), *[corners for corners, _ in parts])


if __name__ == "__main__":
    _main(*sys.argv[1:])
