"""How pytest checks the annotations of the package (see --jaxtyping-packages in pyproject.toml)."""

import numpy as np
from beartype import BeartypeConf, FrozenDict, beartype
from numpy.typing import ArrayLike
from viser import ClientHandle

typechecker = beartype(
    conf=BeartypeConf(
        hint_overrides=FrozenDict(
            {
                # A number out of an array is a number, and a whole one is a float.
                int: int | np.integer,
                float: float | int | np.floating | np.integer,
                # Its many protocols refuse a list of tuples, which NumPy takes.
                ArrayLike: object,
                ArrayLike | None: object,
                # Tests stand in for pages that no browser shows.
                ClientHandle: object,
            }
        )
    )
)
