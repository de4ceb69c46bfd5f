"""Refine the grasps of a file, save them, and simulate them.

The file is written first: sampled grasps with noise, as a network would predict them. Give your own instead; files of
other programs are recognised by what is in them.
"""

import numpy as np

import grasp_refine as gr

hand, mug = gr.load_hand("allegro"), gr.load_object("mug")

drawn = gr.sample_grasps(hand, mug, 4, seed=0)
noise = np.random.default_rng(0).normal(0.0, 0.05, drawn.q.shape)  # radians
gr.GraspSet.of(hand, drawn.hand_pose, drawn.q + noise, object="mug").save("predicted.npz", overwrite=True)

grasps = gr.load_grasps("predicted.npz")
refined = gr.refine(hand, mug, grasps)
print(refined)  # the table of `refine-grasp run`
refined.save("refined.npz", overwrite=True)  # grasps, pregrasps, squeezes, contacts, forces, measures

trials = gr.simulate(refined)  # MuJoCo: pushed in six directions
print(f"held: {trials.held[:, 0].sum()} of {len(grasps)} before, {trials.held[:, 1].sum()} after")
