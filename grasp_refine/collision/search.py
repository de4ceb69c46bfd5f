"""Interface of the engines of the narrow phase: the search for the closest points of body pairs.

An engine that answers all items of a batch at once, on a GPU say, implements `Search`; `query.Pairs.search` chooses it.
"""

from __future__ import annotations

from typing import Protocol, runtime_checkable

import numpy as np


@runtime_checkable
class Search(Protocol):
    """Search among the piece pairs of P body pairs (a[p], b[p]), prepared once; then only poses change.

    An answer depends on its own item and previous answer alone, not on the other items of the call, to the last bit: a
    grasp is refined alike in any batch. A distance is exact within the tolerances that the engine was given, or the
    status is FAILED.
    """

    def query(
        self,
        pair: np.ndarray | None,
        T_a: np.ndarray,
        T_b: np.ndarray,
        limit: np.ndarray,
        previous: tuple[np.ndarray, ...] | None,
    ) -> tuple[np.ndarray, ...]:
        """Return the fields of a `query.Witness`, in its order and in the shape of `limit`, for M items in all.

        Args:
            pair: Body pair of each item (M,); None: all P pairs, repeated.
            T_a: Poses (M, 4, 4) of the first bodies in the world.
            T_b: Poses of the second bodies.
            limit: Signed distance in metres that an answer has to be below, or it is FAR; NaN: the item is passed over.
            previous: Winners, points on a, points on b and statuses of the last answer. They change the work, and the
                result by rounding only.
        """
        ...
