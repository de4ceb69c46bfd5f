"""Pairs of geoms of a MuJoCo model that can touch."""

from __future__ import annotations

import mujoco


def touching_pairs(model: mujoco.MjModel) -> list[tuple[int, int]]:
    """Return the pairs of geoms that MuJoCo lets collide.

    In these pairs one geom has a bit in `contype` that the other has in `conaffinity`, unless their bodies are
    welded together, or are child and parent, or are excluded; and pairs of the model's own list.
    """
    excluded = set(model.exclude_signature.tolist())
    weld, parent = model.body_weldid, model.body_weldid[model.body_parentid[model.body_weldid]]

    def collide(a: int, b: int) -> bool:
        bits = model.geom_contype[a] & model.geom_conaffinity[b] or model.geom_contype[b] & model.geom_conaffinity[a]
        first, second = sorted((model.geom_bodyid[a], model.geom_bodyid[b]))
        w, v = weld[first], weld[second]
        related = w != 0 and v != 0 and (parent[first] == v or parent[second] == w)
        return bool(bits and w != v and not related and (int(first) << 16) + int(second) not in excluded)

    pairs = [(a, b) for a in range(model.ngeom) for b in range(a + 1, model.ngeom) if collide(a, b)]
    return pairs + list(zip(model.pair_geom1.tolist(), model.pair_geom2.tolist(), strict=True))
