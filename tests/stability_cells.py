"""Cells that tests make up."""

from __future__ import annotations

from typing import Any

from grasp_refine_apps.bench.stability.rows import Cell


def forward(**changed: Any) -> Cell:
    """A cell on queries, with other values for some fields."""
    return Cell(**{
        "kind": "box", "diagonal": 0.1, "state": "near", "measure": "forward", "dtype": "float64", "queries": 10,
        "batch": 4, "engine": "python", "error_max": 1e-6, "distance_error_max_m": 1e-15,
        "points_error_max": 1e-5, **changed,
    })  # fmt: skip


def derivative(**changed: Any) -> Cell:
    """The same on derivatives."""
    return Cell(**{
        "kind": "box", "diagonal": 0.1, "state": "near", "measure": "derivative", "dtype": "float64", "queries": 3,
        "method": "distance", "neighborhood": "adaptive", "derivative_error_max": 1e-3, **changed,
    })  # fmt: skip
