"""Scanned objects: the most probable completion of a scan, with all others."""

from __future__ import annotations

from grasp_refine.objects.object import Object
from grasp_refine.scans.hypothesis import Hypothesis
from grasp_refine.scans.scan import Scan


def scanned_object(
    name: str, scan: Scan, hypotheses: tuple[Hypothesis, ...], *, candidates: int = 1024, seed: int = 0
) -> Object:
    """Return the object of a scan: its most probable completion, which knows the scan and all completions.

    Args:
        name: Name of the object.
        scan: The scan.
        hypotheses: Completions, the most probable first.
        candidates: Number of points on the surface of each.
        seed: Seed of these points.
    """
    import trimesh

    pieces = hypotheses[0].pieces
    mesh = trimesh.util.concatenate([piece.mesh() for piece in pieces])
    assert isinstance(mesh, trimesh.Trimesh)
    return Object(
        name,
        mesh,
        len(pieces) == 1,
        supplied=pieces,
        candidates=candidates,
        seed=seed,
        scan=scan,
        hypotheses=hypotheses,
    )
