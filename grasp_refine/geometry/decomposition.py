"""CoACD in a process of its own: some meshes crash the process that it runs in, and it cannot be interrupted."""

from __future__ import annotations

import json
import sys
import tempfile
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from grasp_refine.core.child import Ended, limit_child, run_module
from grasp_refine.core.errors import MeshError

TIME_LIMIT_S = 600.0
"""Processor time in seconds of one decomposition: five minutes on two cores."""

COARSE_THRESHOLD = 0.1
"""Smallest concavity of a piece where the time is short."""

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
    time_limit: float = TIME_LIMIT_S
    """Processor time in seconds, all cores together, after which coarser pieces are used, with a note; inf: none."""

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
        if not self.time_limit >= 1:
            raise MeshError(f"decomposition: time_limit must be at least 1 s, got {self.time_limit:g}")

    @property
    def search(self) -> dict[str, float | str]:
        """Settings by name that determine the pieces: all but the time limit."""
        settings = asdict(self)
        del settings["time_limit"]
        return settings

    def coarser(self) -> Decomposition:
        """Settings that take a fraction of the time, for a mesh on which these take too long."""
        return replace(
            self,
            threshold=max(self.threshold, COARSE_THRESHOLD),
            preprocess="off",
            resolution=1000,
            mcts_nodes=10,
            mcts_iterations=60,
            mcts_max_depth=2,
            time_limit=self.time_limit / 2,
        )


class OutOfTimeError(MeshError):
    """A decomposition that takes longer than its settings allow."""


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
        OutOfTimeError: CoACD used up the time of the settings.
        MeshError: CoACD ended without a result.
    """
    modes = ("off", "auto") if single and config.preprocess == "auto" else (config.preprocess,)
    for mode in modes:
        parts, end = _run(vertices, faces, config.search | {"preprocess": mode}, config.time_limit, threads, check)
        if parts is not None:
            return parts
        if end.out_of_time:
            raise OutOfTimeError(f"CoACD takes more than {config.time_limit:g} s of processor time")
    raise MeshError(f"CoACD ended without a result ({end.fault})")


def _run(
    vertices: np.ndarray,
    faces: np.ndarray,
    settings: dict[str, float | str],
    time_limit: float,
    threads: int | None,
    check: Callable[[], None],
) -> tuple[list[np.ndarray] | None, Ended]:
    """The parts, or None, and the end of the child process."""
    with tempfile.TemporaryDirectory(prefix="grasp-refine-") as folder:
        np.savez(Path(folder, "mesh.npz"), vertices=vertices, faces=faces)
        end = run_module(
            "grasp_refine.geometry.decomposition",
            folder,
            json.dumps(settings),
            processor_s=time_limit,
            # Threads that wait for others would use up processor time.
            environment={"OMP_WAIT_POLICY": "passive"} | ({} if threads is None else {"OMP_NUM_THREADS": str(threads)}),
            check=check,
        )
        if end.code != 0:
            return None, end
        with np.load(Path(folder, "parts.npz"), allow_pickle=False) as arrays:
            return [arrays[f"arr_{index}"] for index in range(len(arrays.files))], end


def _main(limits: str, folder: str, settings: str) -> None:
    """Run the child process: `mesh.npz` of `folder` in, `parts.npz` out."""
    limit_child(limits)
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
