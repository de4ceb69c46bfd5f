"""A parallel gripper as a bare URDF, the smallest hand that grasps."""

PLATE = '<collision><geometry><box size="0.01 0.03 0.06"/></geometry></collision>'

URDF = f"""<robot name="gripper">
  <link name="palm"><collision><geometry><box size="0.2 0.03 0.02"/></geometry></collision></link>
  <link name="left">{PLATE}</link><link name="right">{PLATE}</link>
  <joint name="l" type="prismatic"><parent link="palm"/><child link="left"/><origin xyz="0.09 0 0.05"/>
    <axis xyz="-1 0 0"/><limit lower="0" upper="0.07" effort="1" velocity="1"/></joint>
  <joint name="r" type="prismatic"><parent link="palm"/><child link="right"/><origin xyz="-0.09 0 0.05"/>
    <axis xyz="-1 0 0"/><limit lower="-0.07" upper="0" effort="1" velocity="1"/></joint>
</robot>"""
"""Two plates that slide on a palm, each on its own, from 17 to 3 cm between them."""
