"""Names of grasp formats as choices of options: ours, and of installed packages."""

from typing import TYPE_CHECKING, Literal

from grasp_refine.grasps.formats.listing import FORMATS

if TYPE_CHECKING:
    FormatName = str
else:
    FormatName = Literal[tuple(known.name for known in FORMATS)]
