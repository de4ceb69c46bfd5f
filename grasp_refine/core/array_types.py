"""Types of arrays by number and shape, as in `Float[np.ndarray, "batch 3"]`, for annotations.

They are jaxtyping's wherever it is loaded before, as in tests, which check shapes by it. Elsewhere they are annotations
without a check, and jaxtyping need not be installed.
"""

import sys
from typing import TYPE_CHECKING

if not TYPE_CHECKING and "jaxtyping" in sys.modules:
    from jaxtyping import Bool, Float, Float32, Int, Integer, Shaped, UInt8, UInt32
else:
    from typing import Annotated as Bool
    from typing import Annotated as Float
    from typing import Annotated as Float32
    from typing import Annotated as Int
    from typing import Annotated as Integer
    from typing import Annotated as Shaped
    from typing import Annotated as UInt8
    from typing import Annotated as UInt32

__all__ = ["Bool", "Float", "Float32", "Int", "Integer", "Shaped", "UInt8", "UInt32"]
