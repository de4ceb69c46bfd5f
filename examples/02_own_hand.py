"""Refine grasps of a hand of your own: its URDF is enough.

Here a gripper of two jaws is written first. Fingertips, rest pose and fingers are found; a hand.toml can state them.
"""

from pathlib import Path

import grasp_refine as gr

BOX = '<collision><origin xyz="0 0 {z}"/><geometry><box size="{size}"/></geometry></collision>'
JAW = """
  <link name="{side}">{box}</link>
  <joint name="{side}_slide" type="prismatic"><parent link="palm"/><child link="{side}"/><origin xyz="{x} 0 0.02"/>
    <axis xyz="{x} 0 0"/><limit lower="-0.04" upper="0.0" effort="40" velocity="1"/></joint>"""

palm, jaw = BOX.format(z=0, size="0.12 0.04 0.04"), BOX.format(z=0.03, size="0.01 0.02 0.06")
jaws = "".join(JAW.format(side=side, x=x, box=jaw) for side, x in (("left", 0.05), ("right", -0.05)))
Path("gripper.urdf").write_text(f'<robot name="gripper"><link name="palm">{palm}</link>{jaws}</robot>')

hand = gr.load_hand("gripper.urdf")
print(hand)  # joints, links that touch, what was guessed
for note in hand.notes:
    print("note:", note)

box = gr.load_object("box:0.03,0.04,0.08")
refined = gr.refine(hand, box, gr.sample_grasps(hand, box, 4))
print(refined)
