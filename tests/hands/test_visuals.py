"""What links show: placed, scaled, mirrored and coloured as the URDF says, and what is broken is told."""

from pathlib import Path

import numpy as np
import pytest
import trimesh

from grasp_refine.hands.files.visuals import Visual, load_visuals
from refusals import assert_names

ROBOT = """<robot name="r">
  <material name="brick"><color rgba="0.8 0.2 0.1 1"/></material>
  <link name="base">{}</link><link name="tip">{}</link>
  <joint name="j" type="fixed"><parent link="base"/><child link="tip"/></joint>
</robot>"""
BOX = '<visual><origin xyz="1 2 3"/><geometry><box size="0.2 0.4 0.6"/></geometry>{}</visual>'


def load(folder: Path, base: str, tip: str = "") -> tuple[list[Visual], list[str]]:
    path = folder / "hand.urdf"
    path.write_text(ROBOT.format(base, tip))
    said: list[str] = []
    return load_visuals(path, {"base", "tip"}, said.append), said


def test_a_primitive_is_placed(tmp_path: Path):
    (visual,), said = load(tmp_path, BOX.format(""))
    assert visual.link == "base" and visual.color is None and said == []
    np.testing.assert_allclose(visual.mesh.bounds, [[0.9, 1.8, 2.7], [1.1, 2.2, 3.3]], atol=1e-12)
    assert visual.mesh.volume == pytest.approx(0.2 * 0.4 * 0.6)


def test_a_mesh_is_scaled_mirrored_and_turned(tmp_path: Path):
    wedge = trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [0, 2, 0], [0, 0, 3]], [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    wedge.export(tmp_path / "wedge.obj")
    turned = (
        '<visual><origin rpy="0 0 1.5707963267948966"/><geometry><mesh filename="{}" scale="{}"/></geometry></visual>'
    )
    visuals, said = load(tmp_path, turned.format("wedge.obj", "0.1 0.1 -0.1"), turned.format("wedge.obj", "0.1"))
    assert said == [] and [visual.link for visual in visuals] == ["base", "tip"]
    np.testing.assert_allclose(visuals[0].mesh.bounds, [[-0.2, 0, -0.3], [0, 0.1, 0]], atol=1e-12)
    np.testing.assert_allclose(visuals[1].mesh.bounds, [[-0.2, 0, 0], [0, 0.1, 0.3]], atol=1e-12)
    # Faces look outward also where the mesh is mirrored.
    assert [visual.mesh.volume for visual in visuals] == pytest.approx([1e-3, 1e-3])


def test_colours_come_from_the_visual_or_by_name(tmp_path: Path):
    own = '<material name="own"><color rgba="0.1 0.5 2 1"/></material>'
    visuals, said = load(
        tmp_path,
        BOX.format(own) + BOX.format('<material name="brick"/>'),
        # Named at another link, or nowhere.
        BOX.format('<material name="own"/>') + BOX.format('<material name="none"/>'),
    )
    assert [visual.color for visual in visuals] == [(0.1, 0.5, 1.0), (0.8, 0.2, 0.1), (0.1, 0.5, 1.0), None]
    assert said == []


@pytest.mark.parametrize(
    ("broken", "named"),
    [
        ('<visual><geometry><mesh filename="none.obj"/></geometry></visual>', ("'none.obj'",)),
        ('<visual><geometry><mesh filename="flat.obj"/></geometry></visual>', ("flat.obj",)),
        ('<visual><geometry><mesh filename="mesh.3ds"/></geometry></visual>', ("'.3ds'",)),
        ("<visual><geometry><teapot/></geometry></visual>", ("<teapot>",)),
        ("<visual/>", ("<visual>", "<geometry>")),
        ('<visual><geometry><box size="1 2"/></geometry></visual>', ('<box size="1 2">', "3")),
        ('<visual><geometry><sphere radius="-1"/></geometry></visual>', ("sphere", "-1")),
        (BOX.format('<material name="m"><color rgba="red"/></material>'), ('rgba="red"',)),
    ],
)
def test_what_is_broken_is_left_out_and_reported(tmp_path: Path, broken: str, named: tuple[str, ...]):
    (tmp_path / "flat.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    (tmp_path / "mesh.3ds").write_text("")
    visuals, said = load(tmp_path, broken + BOX.format(""), BOX.format(""))
    assert [visual.link for visual in visuals] == ["base", "tip"]
    (line,) = said
    assert_names(line, "'base'", *named)
