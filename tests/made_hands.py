"""Builder of URDF files of made-up hands: links, joints and shapes as short calls."""

from pathlib import Path

from grasp_refine.hands.hand import Hand, load_hand

SIZES = {"sphere": ("radius",), "box": ("size",), "cylinder": ("radius", "length"), "mesh": ("filename",)}
"""Shape -> attributes of its sizes, in the order of texts such as "cylinder 0.01 0.04"."""


def numbers(values: object) -> str:
    """Text of one or several numbers."""
    return " ".join(map(str, values)) if isinstance(values, tuple) else str(values)


def origin(at: tuple | str | None, rpy: tuple | str | None = None) -> str:
    """Place (metres) and angles (radians); empty where there are none."""
    parts = [f'{name}="{numbers(value)}"' for name, value in (("xyz", at), ("rpy", rpy)) if value is not None]
    return f"<origin {' '.join(parts)}/>" if parts else ""


def solid(shape: str, at: tuple | str | None = None, rpy: tuple | str | None = None, kind: str = "collision") -> str:
    """Geometry of a link: a shape such as "sphere 0.01", "box 0.1 0.1 0.02", "cylinder 0.01 0.04", "mesh tip.stl"."""
    name, *sizes = shape.split()
    sizes = [" ".join(sizes)] if name == "box" else sizes
    values = " ".join(f'{key}="{size}"' for key, size in zip(SIZES[name], sizes, strict=True))
    return f"<{kind}>{origin(at, rpy)}<geometry><{name} {values}/></geometry></{kind}>"


def inertial(mass: float, moments: tuple[float, float, float], at: tuple | str | None = None) -> str:
    """Mass in kg, and its moments of inertia (x, y, z) about a place."""
    values = " ".join(f'i{k}{k}="{value}"' for k, value in zip("xyz", moments, strict=True))
    products = 'ixy="0" ixz="0" iyz="0"'
    return f'<inertial>{origin(at)}<mass value="{mass}"/><inertia {values} {products}/></inertial>'


BALL = solid("sphere 0.01")
"""A ball of 1 cm."""


def link(name: str, *inside: str) -> str:
    """A link with geometry and inertia."""
    return f'<link name="{name}">{"".join(inside)}</link>'


def links(*names: str, inside: str = "") -> str:
    """Links that are alike."""
    return "".join(link(name, inside) for name in names)


def joint(
    name: str,
    parent: str,
    child: str,
    kind: str = "revolute",
    *inside: str,
    at: tuple | str | None = None,
    rpy: tuple | str | None = None,
    axis: tuple | str | None = None,
    limits: tuple[float, float] | None = None,
    effort: float | None = 1,
    velocity: float | None = 1,
    follow: tuple | None = None,
) -> str:
    """A joint between two links.

    Args:
        name: Name.
        parent: Parent link.
        child: Child link.
        kind: Type.
        inside: Further elements.
        at: Place in the parent's frame, metres.
        rpy: Angles in the parent's frame, radians.
        axis: Axis in the child's frame.
        limits: Lower and upper limit; None: no element.
        effort: Largest effort; None: not given.
        velocity: Largest velocity; None: not given.
        follow: Joint that it follows, with its multiplier and offset where these are given.
    """
    text = origin(at, rpy)
    if axis is not None:
        text += f'<axis xyz="{numbers(axis)}"/>'
    if follow is not None:
        text += "<mimic" + "".join(
            f' {key}="{value}"' for key, value in zip(("joint", "multiplier", "offset"), follow, strict=False)
        )
        text += "/>"
    if limits is not None:
        most = {"effort": effort, "velocity": velocity}
        most_text = "".join(f' {key}="{value}"' for key, value in most.items() if value is not None)
        text += f'<limit lower="{limits[0]}" upper="{limits[1]}"{most_text}/>'
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f"{text}{''.join(inside)}</joint>"
    )


def slide(name: str, parent: str, child: str, **settings: object) -> str:
    """A joint that slides; settings are those of `joint`."""
    return joint(name, parent, child, "prismatic", **settings)  # type: ignore[arg-type]


def robot(name: str, *parts: str) -> str:
    """A URDF of links and joints."""
    return f'<robot name="{name}">{"".join(parts)}</robot>'


def write_urdf(folder: Path, *parts: str, name: str = "hand", toml: str | None = None) -> Path:
    """Write NAME.urdf of links and joints, and beside it hand.toml, if any; return its path."""
    folder.mkdir(exist_ok=True)
    path = folder / f"{name}.urdf"
    path.write_text(robot(name, *parts))
    if toml is not None:
        (folder / "hand.toml").write_text(toml)
    return path


def made_hand(folder: Path, *parts: str, name: str = "hand", toml: str | None = None, candidates: int = 16) -> Hand:
    """A hand of links and joints; see `write_urdf`."""
    return load_hand(write_urdf(folder, *parts, name=name, toml=toml), candidates=candidates)
