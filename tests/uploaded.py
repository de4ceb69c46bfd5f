"""Uploads for tests: zips, a hand of boxes, and which files are opened meanwhile."""

from __future__ import annotations

import io
import sys
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager

import trimesh

LIMIT = '<limit lower="0" upper="1.2" effort="1" velocity="1"/>'

TIP = trimesh.creation.box((0.02, 0.02, 0.05)).export(file_type="stl")


def zipped(files: Mapping[str, bytes | str], method: int = zipfile.ZIP_DEFLATED) -> bytes:
    """A zip of some files."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", method) as archive:
        for name, content in files.items():
            archive.writestr(name, content, method)
    return stream.getvalue()


def gripper(mesh: str = "package://gripper/meshes/tip.stl", visual: str = "", before: str = "") -> str:
    """A URDF of a palm and two fingers that close, whose tips are a mesh."""
    shown = f'<visual><geometry><mesh filename="{visual}"/></geometry></visual>' if visual else ""
    fingers = "".join(
        f"""<link name="{side}">{shown}<collision><origin xyz="0 0 0.04"/>
        <geometry><mesh filename="{mesh}"/></geometry></collision></link>
        <joint name="{side}_hinge" type="revolute"><parent link="palm"/><child link="{side}"/>
        <origin xyz="{x} 0 0.01"/><axis xyz="0 {-1 if x > 0 else 1} 0"/>{LIMIT}</joint>"""
        for side, x in (("left", -0.06), ("right", 0.06))
    )
    palm = '<link name="palm"><collision><geometry><box size="0.14 0.04 0.02"/></geometry></collision></link>'
    return f'{before}<robot name="gripper">{palm}{fingers}</robot>'


def gripper_zip(**changes: str) -> bytes:
    """A ROS package of this hand, with other files as `changes` say: name -> content."""
    files: dict[str, bytes | str] = {"gripper/urdf/gripper.urdf": gripper(), "gripper/meshes/tip.stl": TIP}
    return zipped({**files, **changes})


_watched: list[list[str]] = []


def _hear(event: str, arguments: tuple[object, ...]) -> None:
    if event == "open" and _watched:
        for opened in _watched:
            opened.append(str(arguments[0]))


@contextmanager
def opened_files() -> Iterator[list[str]]:
    """The files that Python opens in the block."""
    if not _hear.__dict__.get("added"):
        sys.addaudithook(_hear)
        _hear.__dict__["added"] = True
    opened: list[str] = []
    _watched.append(opened)
    try:
        yield opened
    finally:
        _watched.remove(opened)
