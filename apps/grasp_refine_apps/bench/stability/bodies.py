"""Bodies of all kinds, made as a user's are: points scaled to metres, hulls of them, a body of the pieces."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from grasp_refine.core.errors import MeshError
from grasp_refine.geometry.body import Body, build_body
from grasp_refine.geometry.pieces import Piece, capsule, hull, sphere
from grasp_refine_apps.bench.queries.cases import make_body, points_on_ellipsoid
from grasp_refine_apps.bench.stability.cases import KINDS, Kind

Maker = Callable[[float], Sequence[Piece]]
"""From a scale to the pieces of a body."""

PLATE_THICKNESS = 1e-4
"""Thickness of a plate over its diagonal."""

COPY_OFFSETS = (0.0, 1e-13, 1e-12, 1e-11, 1e-10, 1e-9, 1e-8, 1e-7, 1e-6)
"""Offsets of near-duplicates of a vertex, in diagonals."""


@dataclass(frozen=True)
class BodyPairs:
    """The pairs of bodies of a kind at one size."""

    pairs: tuple[tuple[Body, Body], ...]
    """First and second bodies."""
    refused: tuple[str, ...]
    """Reasons why other pairs of the kind could not be built, a message each."""


def make_pairs(kind: Kind, diagonal: float, seed: int) -> BodyPairs:
    """Make all pairs of a kind, the larger body of each with this diagonal in metres."""
    rng = np.random.default_rng((seed, KINDS.index(kind)))
    pairs, refused = [], []
    for k, makers in enumerate(MAKERS[kind](rng)):
        try:
            size = max(build_body(kind, make(1.0), candidates=1).diagonal for make in makers)
            first, second = (
                build_body(f"{kind} {k}{side}", make(diagonal / size), seed=seed)
                for side, make in zip("ab", makers, strict=True)
            )
        except MeshError as error:
            refused.append(str(error))
        else:
            pairs.append((first, second))
    return BodyPairs(tuple(pairs), tuple(refused))


def _spheres(rng: np.random.Generator) -> list[tuple[Maker, Maker]]:
    """Make spheres and capsules, one of them against a polytope that is nearly round."""
    ball, small = _sphere(0.3, (0.1, -0.2, 0.05)), _sphere(0.11, (0.0, 0.0, 0.0))
    pill, other = _capsule(0.1, (-0.2, 0.1, 0.0), (0.3, 0.0, 0.1)), _capsule(0.15, (0.0, 0.0, 0.0), (0.0, 0.0, 0.3))
    return [(ball, small), (ball, ball), (ball, pill), (pill, other), (_hull(_round(rng, 200, (0.3, 0.3, 0.3))), pill)]


def _boxes(rng: np.random.Generator) -> list[tuple[Maker, Maker]]:
    """Make two boxes, two equal cubes, a box against a sphere."""
    cube = _hull(_box((1.0, 1.0, 1.0)))
    ball = _sphere(0.2, (0.0, 0.0, 0.0))
    return [(_hull(_box((0.6, 0.5, 0.7))), _hull(_box((0.3, 0.2, 0.1)))), (cube, cube), (cube, ball)]


def _needles(rng: np.random.Generator) -> list[tuple[Maker, Maker]]:
    """Make a bar 1000 times as long as thick and a splinter with two tips, against each other and a box."""
    bar, splinter = _hull(_box((1.0, 1e-3, 1e-3))), _hull(_round(rng, 20, (0.5, 5e-4, 5e-4)))
    return [(bar, bar), (bar, splinter), (_hull(_box((0.3, 0.4, 0.5))), splinter)]


def _plates(rng: np.random.Generator) -> list[tuple[Maker, Maker]]:
    """Make a plate against another one, and against a finger tip."""
    plate, disc = _box((0.8, 0.6, PLATE_THICKNESS)), _ring(48) * (0.3, 0.3, PLATE_THICKNESS / 2)
    return [(_hull(plate), _hull(disc)), (_hull(plate), _hull(plate)), (_hull(plate), _hull(_round(rng, 60)))]


def _thousands(rng: np.random.Generator) -> list[tuple[Maker, Maker]]:
    """Make an ellipsoid of 1000 vertices, and one of 300."""
    return [(_hull(_round(rng, 1000)), _hull(_round(rng, 300, (0.3, 0.25, 0.2))))]


def _coils(rng: np.random.Generator) -> list[tuple[Maker, Maker]]:
    """Make two coils of 40 pieces, and one against a finger tip."""
    first, second = (
        [piece.vertices for piece in make_body(40, 10, seed).pieces] for seed in rng.integers(1 << 31, size=2)
    )
    return [(_hull(*first), _hull(*second)), (_hull(*first), _hull(_round(rng, 60, (0.02, 0.015, 0.03))))]


def _duplicates(rng: np.random.Generator) -> list[tuple[Maker, Maker]]:
    """Make bodies with every vertex several times, and points in the middle of edges, of faces and of the body."""
    grid = np.stack(np.meshgrid(*[[-0.5, -0.25, 0.0, 0.5]] * 3), axis=-1).reshape(-1, 3) * (0.8, 0.6, 0.5)
    cloud = _round(rng, 40)
    cloud = np.concatenate([cloud, cloud, 0.5 * cloud, cloud[::-1]])
    return [(_hull(np.tile(grid, (3, 1))), _hull(0.5 * grid)), (_hull(np.tile(grid, (2, 1))), _hull(cloud))]


def _near_duplicates(rng: np.random.Generator) -> list[tuple[Maker, Maker]]:
    """Make bodies with every vertex several times, in places that differ by 1e-13 to 1e-6 of the diagonal."""
    box, cloud = _box((0.6, 0.6, 0.5)), _round(rng, 30)
    first, second = (_copied(rng, points) for points in (box, cloud))
    return [(_hull(first), _hull(0.5 * first[::-1])), (_hull(first), _hull(second)), (_hull(second), _hull(second))]


def _slivers(rng: np.random.Generator) -> list[tuple[Maker, Maker]]:
    """Make needle-like faces: a cylinder of 128 sides, a cone with a base that is not quite flat, thin wedges."""
    base = np.append(_ring(128)[:128] * (0.4, 0.4, 0.0), [[0.0, 0.0, 0.6]], axis=0)
    base[:128, 2] += 1e-8 * rng.normal(size=128)
    wedge = np.array([[-0.5, -0.3, 0], [0.5, -0.3, 0], [0, 0.4, 0], [0.1, 0, 1]])
    cylinder = _hull(_ring(128) * (0.3, 0.3, 0.4))
    thin, flat = (_hull(wedge * (1, 1, thickness)) for thickness in (1e-5, 1e-7))
    return [(cylinder, _hull(base)), (cylinder, thin), (thin, thin), (_hull(base), flat)]


MAKERS: Mapping[Kind, Callable[[np.random.Generator], list[tuple[Maker, Maker]]]] = MappingProxyType(
    {
        "ball": _spheres,
        "box": _boxes,
        "needle": _needles,
        "plate": _plates,
        "hull1000": _thousands,
        "concave40": _coils,
        "duplicates": _duplicates,
        "near-duplicates": _near_duplicates,
        "slivers": _slivers,
    }
)
"""Kind -> function that makes its pairs."""


def _sphere(radius: float, center: tuple[float, float, float]) -> Maker:
    return lambda scale: [sphere(radius * scale, np.array(center) * scale)]


def _capsule(radius: float, start: tuple[float, float, float], end: tuple[float, float, float]) -> Maker:
    return lambda scale: [capsule(radius * scale, np.array(start) * scale, np.array(end) * scale)]


def _hull(*points: np.ndarray) -> Maker:
    return lambda scale: [hull(cloud * scale) for cloud in points]


def _box(extents: tuple[float, float, float]) -> np.ndarray:
    return 0.5 * np.array(extents) * [[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]


def _round(rng: np.random.Generator, count: int, half: tuple[float, float, float] = (0.5, 0.35, 0.25)) -> np.ndarray:
    """Points on an ellipsoid."""
    return points_on_ellipsoid(rng, count, half)


def _ring(sides: int) -> np.ndarray:
    """Corners of a prism of radius 1 with its ends at z = 1 and -1."""
    angle = 2 * np.pi * np.arange(sides) / sides
    ring = np.stack([np.cos(angle), np.sin(angle), np.ones(sides)], axis=1)
    return np.concatenate([ring, ring * (1, 1, -1)])


def _copied(rng: np.random.Generator, points: np.ndarray) -> np.ndarray:
    """All points with their near-duplicates."""
    return np.concatenate([points + copy * rng.uniform(-1, 1, points.shape) for copy in COPY_OFFSETS])
