"""Isometries: the symmetries that objects may have."""

from __future__ import annotations

import numpy as np

TURNS = 16
"""Rotations about an axis of revolution."""


def images_of(isometries: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Images (..., n, 3) of points (n, 3)."""
    return points @ np.swapaxes(isometries[..., :3, :3], -1, -2) + isometries[..., None, :3, 3]


def about(R: np.ndarray, centers: np.ndarray) -> np.ndarray:
    """Isometries (..., 4, 4) with linear parts R (..., 3, 3) that keep centres (..., 3)."""
    T = np.zeros((*np.broadcast_shapes(R.shape[:-2], centers.shape[:-1]), 4, 4))
    T[..., :3, :3], T[..., 3, 3] = R, 1.0
    T[..., :3, 3] = centers - np.einsum("...ij,...j->...i", T[..., :3, :3], centers)
    return T


def mirror(parameters: np.ndarray) -> np.ndarray:
    """Reflections (N, 1, 4, 4) about planes through points on z with normals (x, y, 1): parameters x, y, z (N, 3)."""
    normal = parameters * [1.0, 1.0, 0.0] + [0.0, 0.0, 1.0]
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    R = np.eye(3) - 2.0 * normal[:, :, None] * normal[:, None]
    return about(R, parameters * [0.0, 0.0, 1.0])[:, None]


def inversion(parameters: np.ndarray) -> np.ndarray:
    """Inversions (N, 1, 4, 4) about centres (N, 3)."""
    return about(-np.eye(3), parameters)[:, None]


def half_turn(parameters: np.ndarray) -> np.ndarray:
    """Half-turns (N, 1, 4, 4) about axes across z: parameters angle, place across and z (N, 3)."""
    angle, across, z = parameters.T
    axis = np.stack([np.cos(angle), np.sin(angle), 0.0 * z], axis=1)
    R = 2.0 * axis[:, :, None] * axis[:, None] - np.eye(3)
    return about(R, np.stack([-np.sin(angle) * across, np.cos(angle) * across, z], axis=1))[:, None]


def revolution(parameters: np.ndarray) -> np.ndarray:
    """Rotations (N, TURNS - 1, 4, 4) about axes: parameters direction and point (N, 6)."""
    axis, centers = parameters[:, :3] / np.linalg.norm(parameters[:, :3], axis=1, keepdims=True), parameters[:, 3:]
    angle = (2.0 * np.pi * np.arange(1, TURNS) / TURNS)[:, None, None]
    cross = np.cross(np.eye(3), axis[:, None])[:, None]
    outer = (axis[:, :, None] * axis[:, None])[:, None]
    R = np.cos(angle) * np.eye(3) - np.sin(angle) * cross + (1.0 - np.cos(angle)) * outer
    return about(R, centers[:, None])


def axes_of_revolution(points: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Directions and points (3, 6) of axes that the normals of a surface of revolution meet, the best first.

    Least squares in Pluecker coordinates (Pottmann and Randrup, Rotational and helical surface approximation, 1998).
    """
    lines = np.hstack([np.cross(points, normals), normals])
    weight = np.ones(len(lines))
    for _ in range(5):
        M = (lines * weight[:, None]).T @ lines
        moments = -np.linalg.pinv(M[3:, 3:], rcond=1e-6) @ M[3:, :3]
        values, vectors = np.linalg.eigh(M[:3, :3] + M[:3, 3:] @ moments)
        missed = np.abs(lines @ np.concatenate([vectors[:, 0], moments @ vectors[:, 0]]))
        weight = 1.0 / (1.0 + (missed / max(2.0 * float(np.median(missed)), 1e-6)) ** 2)
    m = (moments @ vectors).T
    return np.hstack([vectors.T, np.cross(vectors.T, m)])
