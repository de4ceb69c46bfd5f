"""Scans of meshes by exact ray casts."""

from __future__ import annotations

import numpy as np
import trimesh

from grasp_refine.scans.scan import Scan


def first_hits(mesh: trimesh.Trimesh, origin: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distances (N,) from `origin` to the surface along unit directions (N, 3), inf without a hit, and faces (N,)."""
    a, b, c = np.moveaxis(np.asarray(mesh.triangles) - origin, 1, 0)
    # A ray hits the triangle whose three planes through the origin it lies on the same side of.
    sides = np.stack([directions @ np.cross(one, other).T for one, other in ((a, b), (b, c), (c, a))])
    hit = (sides >= 0).all(axis=0) | (sides <= 0).all(axis=0)
    normals = np.asarray(mesh.face_normals)
    slope = directions @ normals.T
    hit &= np.abs(slope) > 1e-9
    distance = np.where(hit, np.einsum("fi,fi->f", a, normals) / np.where(hit, slope, 1.0), np.inf)
    distance[distance <= 0] = np.inf
    return distance.min(axis=1), distance.argmin(axis=1)


def seen(
    mesh: trimesh.Trimesh, *toward: tuple[float, float, float], noise_m: float = 0.0, rays: int = 80, seed: int = 0
) -> Scan:
    """Scan from 0.5 m away, in the directions `toward` the sensors, with noise along the lines of sight."""
    middle = mesh.bounds.mean(axis=0)
    radius = np.linalg.norm(mesh.vertices - middle, axis=1).max()
    rng = np.random.default_rng(seed)
    origins, points, normals, view = [], [], [], []
    for index, direction in enumerate(np.asarray(toward, dtype=float)):
        z = -direction / np.linalg.norm(direction)
        x = np.linalg.svd(z[None])[2][1]
        u, v = np.meshgrid(*[np.linspace(-2.1, 2.1, rays) * radius] * 2)
        directions = (z + u.reshape(-1, 1) * x + v.reshape(-1, 1) * np.cross(z, x)).reshape(-1, 3)
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        origins.append(middle - 0.5 * z)
        distance, face = first_hits(mesh, origins[-1], directions)
        hit = np.isfinite(distance)
        noisy = distance[hit] + noise_m * rng.standard_normal(hit.sum())
        points.append(origins[-1] + noisy[:, None] * directions[hit])
        normals.append(mesh.face_normals[face[hit]])
        view.append(np.full(hit.sum(), index))
    return Scan(np.concatenate(points), np.concatenate(normals), np.array(origins), np.concatenate(view), noise_m)
