"""Check that a hand has links that can touch something."""

from __future__ import annotations

from grasp_refine.core.errors import HandError
from grasp_refine.hands.files.description import links_with_visuals
from grasp_refine.hands.hand import Hand


def check_collides(hand: Hand) -> None:
    """Refuse a hand without any collision geometry.

    Raises:
        HandError: it has none; names the option that takes its visual geometry, where it has that.
    """
    if any(link.body is not None for link in hand.links):
        return
    seen = links_with_visuals(hand.urdf) & hand.links_by_name.keys()
    way_out = (
        "its visual geometry can be used instead: `collision='visual'`" if seen else "it has no visual geometry either"
    )
    raise HandError(f"{hand.urdf}: no link of the hand has collision geometry; {way_out}")
