"""Analytical witness derivatives from the features of polytopes, without smoothing."""

from dataclasses import dataclass

import numpy as np

from grasp_refine.core.arguments import check_fields
from grasp_refine.geometry.pieces import Piece
from grasp_refine.witness.scene import WitnessScene
from grasp_refine.witness.slip import Coupling, Slip, SlipMethod


@dataclass(frozen=True)
class Analytical(SlipMethod):
    """The slip along the feature at the witness point: face, edge or vertex.

    A = I - n n^T on a face, e e^T on an edge, 0 at a vertex: the projection onto the directions in all active
    faces. Round pieces (radius r) add r / (r + d) across. Exact while the feature stays the same; blind to
    neighbouring features, so zero at a vertex.
    """

    tolerance: float = 1e-6
    """Largest distance of the witness from the plane of an active face, as a fraction of the piece's size."""
    coupling: Coupling = "coupled"
    """Solve both slips together, or hold the other witness point fixed."""

    def __post_init__(self) -> None:
        """Refuse settings of other types."""
        check_fields(self)

    def slip(self, scene: WitnessScene) -> Slip:
        """Slip matrices (batch, pair, 3, 3) of both bodies, world frame."""
        sides = scene.sides()
        w = scene.witness
        count = scene.T_world_a.shape[1]
        # Far from the world origin, rounding of points exceeds the tolerance of a plane.
        rounding = 4.0 * np.finfo(np.float64).eps * np.abs(w.point_a).max(axis=-1).T
        local = np.zeros((*sides.point.shape, 3))
        pieces_a, pieces_b = scene.pairs.piece_pairs
        for side, pieces in ((slice(0, count), pieces_a), (slice(count, None), pieces_b)):
            point, normal = sides.point[side], sides.normal[side]
            for winner in np.unique(w.winner[w.winner >= 0]):
                here = (w.winner == winner).T
                local[side][here] = feature_slip(
                    pieces[winner], point[here], normal[here], w.distance.T[here], self.tolerance, rounding[here]
                )
        return Slip.of_sides(scene, sides, local, sampled=False)


def feature_slip(
    piece: Piece,
    x: np.ndarray,
    normal: np.ndarray,
    distance: np.ndarray,
    tolerance: float,
    rounding: np.ndarray | float = 0.0,
) -> np.ndarray:
    """Slip matrices (M, 3, 3) of the face, edge or vertex at points x (M, 3) of one piece, body frame.

    Args:
        piece: The piece.
        x: Points on its surface, metres.
        normal: Outward contact normals (M, 3).
        distance: Signed distances (M,) to the other body, metres; used where the piece is round.
        tolerance: Largest distance of a point from the plane of an active face, as a fraction of the piece's size.
        rounding: Added to that distance, in metres, (M,) or one number.
    """
    core = x - piece.radius * normal
    if len(piece.vertices) == 1:
        along = np.zeros((len(x), 3, 3))
    elif len(piece.vertices) == 2:
        start, stop = piece.vertices
        length = np.linalg.norm(stop - start)
        axis = (stop - start) / length
        inside = np.abs((core - (start + stop) / 2) @ axis) < (0.5 - tolerance) * length - rounding
        along = inside[:, None, None] * np.outer(axis, axis)
    else:
        normals, offsets = piece.planes
        slack = tolerance * piece.extent + np.broadcast_to(rounding, len(x))
        active = np.abs(core @ normals.T - offsets) < slack[:, None]
        # The null space of the active normals; nearly parallel ones count as one face.
        products = (normals[:, :, None] * normals[:, None, :]).reshape(-1, 9)
        gram = (active.astype(np.float64) @ products).reshape(-1, 3, 3)
        values, vectors = np.linalg.eigh(gram)
        free = values < 1e-9 * np.maximum(values[:, -1:], 1.0)
        along = (vectors * free[:, None, :]) @ vectors.mT
    if piece.radius == 0.0:
        return along
    across = np.eye(3) - normal[:, :, None] * normal[:, None, :] - along
    # A depth of one radius, where the other surface passes through the centre, is a pole.
    pole = _MIN_POLE_RATIO * piece.radius
    left = piece.radius + distance
    left = np.where(np.abs(left) < pole, np.copysign(pole, left), left)
    return along + (piece.radius / left)[:, None, None] * across


_MIN_POLE_RATIO = 1e-6
"""Smallest distance of r + d from zero, over r: slips up to a million keep the coupled solution accurate and finite."""
