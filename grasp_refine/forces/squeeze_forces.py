"""Forces of squeezes: padded, one row per grasp, as computed; and flat, as in results."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from grasp_refine.core.array_records import take
from grasp_refine.core.array_types import Float, Int, Shaped
from grasp_refine.core.plurals import count_text


@dataclass(frozen=True, eq=False)
class SqueezeForces:
    """Planned forces of links on the object at K contact points of each of N grasps."""

    links: tuple[str, ...]
    """Names of the links."""
    link: Int[np.ndarray, "N K"]
    """Index (N, K) of the link of each point."""
    point: Float[np.ndarray, "N K 3"]
    """Points (N, K, 3) on the object, object frame, metres."""
    normal: Float[np.ndarray, "N K 3"]
    """Unit normals (N, K, 3) into the object, object frame."""
    vector: Float[np.ndarray, "N K 3"]
    """Forces (N, K, 3) of the links on the object, object frame, newtons; NaN: no contact, or no forces were found."""

    def flat(self) -> ContactForces:
        """Return all forces, one row each."""
        grasp, k = np.nonzero(np.isfinite(self.vector).all(axis=-1))
        names = np.array(self.links, dtype=str)[self.link[grasp, k]]
        return ContactForces(grasp, names, self.point[grasp, k], self.normal[grasp, k], self.vector[grasp, k])


@dataclass(frozen=True, eq=False)
class ContactForces:
    """Planned forces of links on the object at all C contact points of some grasps, one row each."""

    grasp: Int[np.ndarray, " C"]
    """Number (C,) of the grasp, ascending."""
    link: Shaped[np.ndarray, " C"]
    """Name (C,) of the link that presses."""
    point: Float[np.ndarray, "C 3"]
    """Point (C, 3) on the object, object frame, metres."""
    normal: Float[np.ndarray, "C 3"]
    """Unit normal (C, 3) into the object, object frame."""
    vector: Float[np.ndarray, "C 3"]
    """Force (C, 3) of the link on the object, object frame, newtons; may be 0."""

    def __len__(self) -> int:
        """Return the number of forces C."""
        return len(self.grasp)

    def __repr__(self) -> str:
        return (
            f"ContactForces({count_text(len(self), 'force')} of {count_text(len(set(self.grasp.tolist())), 'grasp')})"
        )

    def entries(self) -> dict[str, np.ndarray]:
        """Return the entries of result files: `forces_` and the name of the field -> its values."""
        return {f"forces_{field.name}": getattr(self, field.name) for field in fields(self)}

    @classmethod
    def of_entries(cls, entries: Mapping[str, np.ndarray]) -> ContactForces | None:
        """Return the forces of a result file; None: it has none."""
        names = [f"forces_{field.name}" for field in fields(cls)]
        return cls(*(entries[name] for name in names)) if names[0] in entries else None

    def columns(self) -> dict[str, np.ndarray]:
        """Return one column (C,) per number or name, as for `pandas.DataFrame(refined.forces.columns())`."""
        vectors = {name: getattr(self, name).T for name in ("point", "normal", "vector")}
        split = {f"{name}_{axis}": values[k] for name, values in vectors.items() for k, axis in enumerate("xyz")}
        return {"grasp": self.grasp, "link": self.link, **split}

    def select(self, rows: Int[np.ndarray, " N"]) -> ContactForces:
        """Return the forces of the grasps `rows`, numbered as these."""
        at = [np.flatnonzero(self.grasp == row) for row in rows]
        every = np.concatenate([np.zeros(0, dtype=np.int64), *at])
        found = take(self, every)
        return replace(found, grasp=np.repeat(np.arange(len(rows)), [len(one) for one in at]))

    def of_grasp(self, number: int) -> list[dict[str, Any]]:
        """Return the forces of one grasp for JSON."""
        names = [field.name for field in fields(self) if field.name != "grasp"]
        return [{name: getattr(self, name)[at] for name in names} for at in np.flatnonzero(self.grasp == number)]
