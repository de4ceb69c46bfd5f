"""Refine grasps of a gripper on an arm that stands on a table, and lift the object in simulation."""

import grasp_refine as gr

TABLE = -0.06  # height in metres in the object's frame: the box of 12 cm stands on it
task = gr.Task(
    "tabletop",  # lifted off the table in simulation
    table=TABLE,
    base=[-0.55, 0.0, TABLE, 0.0, 0.0, 0.0],  # of the arm: x, y, z in metres, roll, pitch, yaw in degrees
)

gripper, box = gr.load_hand("franka_hand"), gr.load_object("box:0.05,0.06,0.12")
arm = gr.mount(gr.load_arm("ur5e"), gripper)
grasps = gr.sample_grasps(gripper, box, 4, seed=0)  # poses of the gripper; inverse kinematics reaches them

config = gr.Config(gr.LevenbergMarquardt(iterations=30), starts=1)
refined = gr.refine(arm, box, grasps, config, task=task)
print(refined)
trials = gr.simulate(refined)  # the task that they were refined for
reached = refined.status != "out of reach"
print(f"lifted: {trials.held[:, 1].sum()} of {reached.sum()} in reach")
