"""Random pairs of bodies for the alignment task: convex hulls, or CoACD pieces, at hand-sized diagonals."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from grasp_refine.core.errors import AssetError, GraspRefineError
from grasp_refine.geometry.body import Body, build_body
from grasp_refine.geometry.mesh import SUFFIXES, load_mesh
from grasp_refine.geometry.pieces import Piece, hull
from grasp_refine.geometry.sampling import Candidates
from grasp_refine.geometry.shapes import EMBEDDED
from grasp_refine.objects.object import load_object, prepare

Kind = Literal["convex", "concave"]
KINDS: tuple[Kind, ...] = ("convex", "concave")

DIAGONALS = (0.01, 0.2)
"""Smallest and largest bounding-box diagonal of a body, in metres (arXiv 2511.06267)."""


@dataclass(frozen=True, eq=False)
class BodyPair:
    """Two bodies; the first is fixed."""

    name: str
    """Names of both bodies, for tables."""
    kind: Kind
    """Convex hulls, or unions of convex pieces."""
    a: Body
    """The first body, in its own frame."""
    b: Body
    """The second body, in its own frame."""


def mesh_sources(folder: Path | None) -> list[str | Path]:
    """List sources for `load_object`: the meshes of a folder, sorted by name, or the embedded objects.

    Raises:
        AssetError: the folder is missing or has no meshes.
    """
    if folder is None:
        return list(EMBEDDED)
    if not folder.is_dir():
        raise AssetError(f"--meshes {folder}: no such folder")
    meshes = sorted(path for path in folder.iterdir() if path.suffix.lower() in SUFFIXES)
    if not meshes:
        raise AssetError(f"--meshes {folder}: no meshes in it ({', '.join(SUFFIXES)})")
    return list(meshes)


def draw_pairs(
    sources: Sequence[str | Path],
    kind: Kind,
    count: int,
    seed: int,
    *,
    say: Callable[[str], None],
    candidates: int = 1024,
) -> list[BodyPair]:
    """Draw `count` random pairs of different objects, each scaled to a diagonal drawn uniformly from `DIAGONALS`.

    Objects are loaded when they are drawn. A mesh that cannot be used is reported and another one drawn; a convex
    mesh is not an object of the concave kind.

    Raises:
        GraspRefineError: too few of the meshes can be used.
    """
    rng = np.random.default_rng((seed, KINDS.index(kind)))
    bodies: dict[str | Path, Body | None] = {}

    def body(source: str | Path) -> Body | None:
        if source not in bodies:
            bodies[source] = _load(source, kind, candidates, seed, say)
        return bodies[source]

    def usable() -> list[str | Path]:
        return [source for source in sources if bodies.get(source, source) is not None]

    pairs: list[BodyPair] = []
    while len(pairs) < count:
        left = usable()
        if len(left) < 2:
            others = "give more meshes" if kind == "convex" else "give meshes that are not convex, or --kinds convex"
            raise GraspRefineError(
                f"{kind} pairs need two {kind} objects; {len(left)} of {len(sources)} can be used: {others}"
            )
        first, second = (left[i] for i in rng.choice(len(left), 2, replace=False))
        diagonals = rng.uniform(*DIAGONALS, size=2)
        a, b = body(first), body(second)
        if a is not None and b is not None:
            a, b = (normalised(one, diagonal) for one, diagonal in zip((a, b), diagonals, strict=True))
            # Objects may be drawn again; their sizes distinguish the pairs.
            name = " / ".join(f"{one.name} {1e3 * one.diagonal:.1f} mm" for one in (a, b))
            pairs.append(BodyPair(name, kind, a, b))
    return pairs


def normalised(body: Body, diagonal: float) -> Body:
    """Scale a body to a diagonal (metres), with the centre of its bounding box at the origin of its frame.

    Descent turns a body about its origin, so its position matters.
    """
    bounds = np.stack([piece.bounds for piece in body.pieces])
    center = 0.5 * (bounds[:, 0].min(axis=0) + bounds[:, 1].max(axis=0))
    factor = diagonal / body.diagonal
    pieces = tuple(
        Piece((piece.vertices - center) * factor, piece.faces, piece.radius * factor) for piece in body.pieces
    )
    old = body.candidates
    return Body(body.name, pieces, Candidates((old.points - center) * factor, old.normals, old.areas * factor**2))


def _load(source: str | Path, kind: Kind, candidates: int, seed: int, say: Callable[[str], None]) -> Body | None:
    """Load the body of a mesh at its own size; None where it is not of this kind."""
    try:
        if kind == "convex":
            embedded = EMBEDDED.get(str(source))
            name, mesh = (str(source), embedded()) if embedded else (Path(source).stem, load_mesh(source))
            return build_body(name, [hull(mesh.vertices, name=name)], candidates=candidates, seed=seed)
        found = load_object(source, unit="m", candidates=candidates, seed=seed)
        prepare([found], progress=say)
    except GraspRefineError as error:
        say(f"skipped: {error}")
        return None
    return found.body if len(found.body.pieces) > 1 else None
