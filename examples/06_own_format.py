"""Read grasp files of your own format: here a JSON file per object, with angles in degrees."""

import json
from pathlib import Path

import numpy as np

import grasp_refine as gr


class MyLab(gr.Format):
    """Files {"my_lab": {"object", "pose": [x, y, z, qw, qx, qy, qz], "degrees": {joint: values}}}."""

    name, what = "my_lab", "My lab: one .json file per object, angles in degrees"

    def mismatch(self, content: object) -> str:
        return "" if isinstance(content, dict) and "my_lab" in content else "it has no my_lab"

    def read(self, source: gr.Source, hand: gr.Hand | None) -> tuple[gr.GraspSet, tuple[str, ...]]:
        held = source.content["my_lab"]
        pose = source.poses(held["pose"], "pose")  # errors name file and key
        q = np.radians(source.numbers(list(held["degrees"].values()), "degrees")).T
        count = len(pose)
        base, names = ("palm" if hand is None else hand.base_link), tuple(held["degrees"])
        return gr.GraspSet("", base, names, np.full(count, held["object"]), np.ones(count), pose, q), ()


gr.add_format(MyLab())

hand, mug = gr.load_hand("allegro"), gr.load_object("mug")
drawn = gr.sample_grasps(hand, mug, 3, seed=0)
degrees = dict(zip(drawn.joint_names, np.degrees(drawn.q).T.tolist(), strict=True))
content = {"my_lab": {"object": "mug", "pose": drawn.hand_pose.tolist(), "degrees": degrees}}
Path("my_lab.json").write_text(json.dumps(content))

grasps = gr.load_grasps("my_lab.json", hand=hand)  # recognised by what is in it
refined = gr.refine(hand, mug, grasps)
print(refined)
