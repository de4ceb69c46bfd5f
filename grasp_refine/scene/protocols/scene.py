"""Protocol that lifts the object out of its scene: off a table, a bin or a shelf, among other bodies.

The numbers are from `tabletop`. Flat faces touch in several points, without which bodies on a table would tilt.

Source: that of `tabletop`; that it is lifted out of a scene is ours.
"""

from dataclasses import replace

from grasp_refine.scene.protocols.tabletop import TABLETOP

SCENE = replace(TABLETOP, name="scene", multiccd=True)
