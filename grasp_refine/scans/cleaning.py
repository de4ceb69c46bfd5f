"""From the points of a file or a camera to a scan: thinned, without outliers, with normals towards the sensors."""

from __future__ import annotations

import numpy as np

from grasp_refine.core.array_types import Bool, Float, Int
from grasp_refine.core.errors import MeshError
from grasp_refine.core.plurals import count_text
from grasp_refine.geometry.mesh import MAX_DIAGONAL
from grasp_refine.scans.scan import Plane, Scan

MIN_POINTS = 30
"""Fewest points of a scan."""

MAX_POINTS = 10_000
"""Most points of a scan; more are thinned."""

NEIGHBORS, NOISE_NEIGHBORS = 40, 12
"""Nearest points whose plane gives a normal, and those from whose plane the noise is measured: less curvature."""

OUTLIER_NEIGHBORS, OUTLIER_DEVIATIONS = 8, 3.0
"""Neighbours, and standard deviations above the mean of the mean distance to them that make an outlier.

Source: Rusu, Marton, Blodow, Dolha, Beetz, "Towards 3D Point Cloud Based Object Maps for Household Environments", 2008.
"""

CROWD, GAP_SPACINGS = 0.02, 6.0
"""Share of the points below which a group that lies apart is an outlier, and the distance apart in point spacings."""

APART = 0.5
"""Gap between two groups above which they are two objects, as a share of the diagonal of the larger one."""

FLATNESS, FLAT_NOISES = 0.003, 2.0
"""Standard deviation from one plane below which only a plane was seen, as a share of the diagonal, and in noises."""


TABLE_SHARE, TABLE_ABOVE, TABLE_TRIES = 0.5, 0.95, 64
"""Share of the points in one plane, and of the others on the sensors' side of it, above which the plane may be a table,
and number of planes that are tried. Where a side of an object is a plane, the others are behind it."""


def scan_of_points(
    points: Float[np.ndarray, "P 3"],
    normals: Float[np.ndarray, "P 3"] | None,
    origins: Float[np.ndarray, "V 3"],
    view: Int[np.ndarray, " P"] | None,
    name: str,
    *,
    noise_m: float | None = None,
    masked: bool = False,
    table: Plane | None = None,
) -> tuple[Scan, tuple[str, ...]]:
    """Return the scan of points, and notes for the user.

    Points that are not finite are dropped, a large cloud is thinned, outliers are dropped. Missing normals are those of
    planes through neighbours. Normals face the sensor that saw the point.

    Args:
        points: Points (P, 3) in the frame of the object, metres.
        normals: Normals (P, 3) of any length; NaN or 0: unknown. None: all are unknown.
        origins: Optical centres (V, 3) of the sensors, metres; none: unknown.
        view: Index (P,) of the sensor that saw each point; None: the nearest one.
        name: Name of the object, for messages.
        noise_m: Standard deviation along the lines of sight, metres; None: measured, as the distance from local planes.
        masked: Whether the points are known to be the object's: it may be seen as a plane, as a box from the front.
        table: Plane that was seen around the object, on which it stands; None: it was not seen.

    Raises:
        MeshError: there are too few points, they lie in a plane and are not masked, they are several objects, or
            neither normals nor sensors are known.
    """
    notes = []
    finite = (np.abs(points) < MAX_DIAGONAL).all(axis=1)
    if not finite.all():
        notes.append(f"{count_text(int((~finite).sum()), 'point')} of {len(points)} are not finite; dropped")
        points, normals, view = points[finite], _taken(normals, finite), _taken(view, finite)
    _check_count(len(points), name)
    if normals is None and not len(origins):
        raise MeshError(
            f"{name}: points without normals need the position of the sensor (`seen_from`): which side of them is "
            "outside? In the frame of its camera, a cloud was seen from 0,0,0"
        )
    if view is None:
        away = np.stack([((points - origin) ** 2).sum(axis=1) for origin in origins], axis=1) if len(origins) else None
        view = np.zeros(len(points), dtype=np.int64) if away is None else away.argmin(axis=1)
    before = len(points)
    points, normals, view = thinned(points, normals, view, MAX_POINTS)
    if len(points) < before:
        notes.append(f"{before} points are thinned to {len(points)}")
    kept = ~_outliers(points)
    kept[kept] = _in_groups(points[kept], name)
    if not kept.all():
        notes.append(f"{count_text(int((~kept).sum()), 'outlier')} dropped")
        points, normals, view = points[kept], _taken(normals, kept), view[kept]
    _check_count(len(points), name)
    noise = measured_noise(points) if noise_m is None else noise_m
    flat = _flatness_text(points, noise)
    if flat and not masked:
        raise MeshError(f"{name}: {flat}; is it the table? Mask the object, or add a view of another side")
    if table is not None:
        height = float(((points - table[0]) @ table[1]).max())
        notes.append(f"taken to stand on the plane around it, {height * 1e3:.3g} mm below its highest point")
    elif flat:
        notes.append(f"{flat}: how thick the object is, is a guess; add a view of another side")
    planes = local_planes(points)
    if normals is None:
        normals = planes
    else:
        normals = _plain(normals)
        length = np.linalg.norm(normals, axis=1, keepdims=True)
        normals = np.where(length > 1 / MAX_DIAGONAL, normals / np.maximum(length, 1 / MAX_DIAGONAL), planes)
    if len(origins):
        facing = ((origins[view] - points) * normals).sum(axis=1)
        normals = np.where((facing < 0)[:, None], -normals, normals)
    if len(origins) and not masked and (share := _table_share(points, normals, noise)):
        notes.append(f"{share:.0%} of its points are in a plane below the others; if it is the table, mask the object")
    return Scan(points, normals, np.asarray(origins, dtype=np.float64), view, noise, table), tuple(notes)


def thinned(
    points: Float[np.ndarray, "P 3"],
    normals: Float[np.ndarray, "P 3"] | None,
    view: Int[np.ndarray, " P"],
    most: int,
) -> tuple[Float[np.ndarray, "Q 3"], Float[np.ndarray, "Q 3"] | None, Int[np.ndarray, " Q"]]:
    """Return at most `most` points: the means of those of each view in each cell of a grid, as fine as that allows."""
    if len(points) <= most:
        return points, normals, view
    low = points.min(axis=0)
    # Too fine at first rather than too coarse.
    a, b, c = np.ptp(points, axis=0)
    cell = max(np.sqrt((a * b + b * c + c * a) / most) / 3, float(max(a, b, c)) * 2.0**-19) or 1.0
    weight = np.ones(len(points))
    values = points if normals is None else np.concatenate([points, _plain(normals)], axis=1)
    while len(points) > most:
        at = ((points - low) / cell).astype(np.int64)
        key = at[:, 0] | at[:, 1] << 20 | at[:, 2] << 40
        order = np.lexsort((key, view))
        first = np.flatnonzero(np.diff(key[order], prepend=-1) | np.diff(view[order], prepend=-1))
        total = np.add.reduceat(weight[order], first)
        values = np.add.reduceat(values[order] * weight[order, None], first) / total[:, None]
        points, view, weight = values[:, :3], view[order][first], total
        cell *= 1.2
    return values[:, :3], None if normals is None else values[:, 3:], view


def local_planes(points: Float[np.ndarray, "P 3"]) -> Float[np.ndarray, "P 3"]:
    """Return unit normals (P, 3), of either sign, of planes through the neighbours of points."""
    return np.linalg.eigh(_scatter(points, NEIGHBORS))[1][:, :, 0]


def measured_noise(points: Float[np.ndarray, "P 3"]) -> float:
    """Return the standard deviation of points from planes through their nearest neighbours, metres."""
    # A plane has three parameters.
    least = np.linalg.eigvalsh(_scatter(points, NOISE_NEIGHBORS))[:, 0] / (NOISE_NEIGHBORS - 3)
    return float(np.sqrt(max(np.median(least), 0.0)))


def _scatter(points: Float[np.ndarray, "P 3"], count: int) -> Float[np.ndarray, "P 3 3"]:
    """Return the scatter matrix (P, 3, 3) of the nearest neighbours of each point, itself one of them."""
    from scipy.spatial import cKDTree

    near = points[cKDTree(points).query(points, min(count, len(points)))[1]]
    off = near - near.mean(axis=1, keepdims=True)
    return off.mT @ off


def _plain(normals: Float[np.ndarray, "P 3"]) -> Float[np.ndarray, "P 3"]:
    """Return normals with 0 in place of unknown ones."""
    return np.where((np.abs(normals) < MAX_DIAGONAL).all(axis=1, keepdims=True), normals, 0.0)


def _taken(values: np.ndarray | None, kept: Bool[np.ndarray, " P"]) -> np.ndarray | None:
    return None if values is None else values[kept]


def _check_count(count: int, name: str) -> None:
    if count < MIN_POINTS:
        what = "empty" if count == 0 else f"only {count_text(count, 'point')}"
        raise MeshError(f"{name}: {what}; a scan needs at least {MIN_POINTS} points")


def _outliers(points: Float[np.ndarray, "P 3"]) -> Bool[np.ndarray, " P"]:
    """Return a mask (P,) of points far from their neighbours."""
    from scipy.spatial import cKDTree

    distance = cKDTree(points).query(points, OUTLIER_NEIGHBORS + 1)[0][:, 1:].mean(axis=1)
    # Of a clean cloud nothing is dropped.
    return distance > np.maximum(distance.mean() + OUTLIER_DEVIATIONS * distance.std(), 3 * np.median(distance))


def _in_groups(points: Float[np.ndarray, "P 3"], name: str) -> Bool[np.ndarray, " P"]:
    """Return a mask (P,) of points in groups of at least `CROWD`.

    Raises:
        MeshError: two of these are far apart.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    tree = cKDTree(points)
    distance, index = tree.query(points, min(OUTLIER_NEIGHBORS + 1, len(points)))
    reach = GAP_SPACINGS * float(np.median(distance[:, 1:].mean(axis=1)))
    linked = np.nonzero(distance <= reach)
    graph = coo_array((np.ones(len(linked[0])), (linked[0], index[linked])), shape=(len(points), len(points)))
    label = connected_components(graph, directed=False)[1]
    count = np.bincount(label)
    large = count >= CROWD * len(points)
    groups = [points[label == at] for at in np.flatnonzero(large)]
    if not groups:
        return np.ones(len(points), dtype=bool)
    groups.sort(key=len)
    # What lies nearest to the rest joins it, one group after another: three parts in a row are one object.
    whole = groups.pop()
    while groups:
        tree = cKDTree(whole)
        gaps = [float(tree.query(group)[0].min()) for group in groups]
        gap, size = min(gaps), float(np.linalg.norm(np.ptp(whole, axis=0)))
        if gap > APART * size:
            raise MeshError(
                f"{name}: two objects, {gap * 1e3:.3g} mm apart, the larger {size * 1e3:.3g} mm across; cut out one of "
                "them, or mask it"
            )
        whole = np.concatenate([whole, groups.pop(gaps.index(gap))])
    return large[label]


def _flatness_text(points: Float[np.ndarray, "P 3"], noise: float) -> str:
    """Return a text on points in a plane; empty on others."""
    off = points - points.mean(axis=0)
    deviation = float(np.sqrt(max(np.linalg.eigvalsh(off.T @ off / len(points))[0], 0.0)))
    diagonal = float(np.linalg.norm(np.ptp(points, axis=0)))
    flat = deviation < max(FLATNESS * diagonal, FLAT_NOISES * noise)
    return f"only a plane, {diagonal * 1e3:.3g} mm across, was seen" if flat else ""


def fitted_plane(points: Float[np.ndarray, "P 3"]) -> Plane:
    """Return the middle of points and the normal, of either sign, of the plane at the least squared distances."""
    middle = points.mean(axis=0)
    off = points - middle
    return middle, np.linalg.eigh(off.T @ off)[1][:, 0]


def _table_share(points: Float[np.ndarray, "P 3"], normals: Float[np.ndarray, "P 3"], noise: float) -> float:
    """Return the share of points in a plane that may be a table, see `TABLE_SHARE`; 0: there is none."""
    reach = 3.0 * noise + FLATNESS * float(np.linalg.norm(np.ptp(points, axis=0)))
    for at in np.linspace(0, len(points) - 1, TABLE_TRIES).astype(int):
        middle, normal = points[at], normals[at]
        for _ in range(3):
            # The plane of a point's neighbours, then that of all points near it.
            height = (points - middle) @ normal
            near = np.abs(height) < reach
            if near.sum() < MIN_POINTS:
                break
            middle, normal = fitted_plane(points[near])
            normal = normal if normal @ normals[at] > 0 else -normal
        if near.mean() > TABLE_SHARE and not near.all() and (height[~near] > 0).mean() > TABLE_ABOVE:
            return float(near.mean())
    return 0.0
