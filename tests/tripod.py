"""Three fingers in a row and a thumb that faces them: a right hand or a left one, by the side of its thumb."""

from pathlib import Path

from grasp_refine.hands.hand import Hand, load_hand
from made_hands import joint, links, solid, write_urdf

TIP, BALL = solid("sphere 0.01", "0 0 0.03"), solid("sphere 0.02")


def tripod(folder: Path, *, thumb_at: float, misnamed: bool = False) -> Hand:
    """Three fingers in a row along y that close along x, and one that faces them, at `thumb_at` on y."""
    names = {"thumb_a": -0.03, "b": 0.0, "c": 0.03} if misnamed else {"a": -0.03, "b": 0.0, "c": 0.03}
    body = links("palm", inside=BALL)
    for name, at in names.items():
        body += links(name, inside=TIP) + joint(
            f"j{name}", "palm", name, at=(-0.04, at, 0.02), axis="0 1 0", limits=(-0.3, 1.2)
        )
    body += links("d", inside=TIP) + joint(
        "jd", "palm", "d", at=(0.04, thumb_at, 0.02), axis="0 -1 0", limits=(-0.3, 1.2)
    )
    return load_hand(write_urdf(folder, body), candidates=64)
