"""The example grasps of the embedded hand on the embedded box, one of the fastest objects."""

from grasp_refine.assets import resource_dir
from grasp_refine.grasps import load_grasps
from grasp_refine.hand import load_hand
from grasp_refine.objects import load_object
from grasp_refine.scene import Scene
from grasp_refine.se3 import transform_from_pose

FILE = resource_dir("robots") / "allegro/example_rounded_box.npz"


def boxed_example(candidates: int = 256) -> Scene:
    """The four grasps, on bodies with so many candidates."""
    grasps = load_grasps(FILE)
    hand, box = load_hand("allegro", candidates=candidates), load_object("rounded_box", candidates=candidates)
    return Scene(hand, box, transform_from_pose(grasps.hand_pose), grasps.q)
