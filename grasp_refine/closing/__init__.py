"""How a hand closes on an object: pregrasp, squeeze, the motion between."""
