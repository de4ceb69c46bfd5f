"""The example grasps of the embedded hand on the embedded box, one of the fastest objects."""

from grasp_refine.assets.embedded import resource_dir
from grasp_refine.core.se3 import transform_from_pose
from grasp_refine.grasps.grasp_set import load_grasps
from grasp_refine.hands.hand import load_hand
from grasp_refine.objects.object import load_object
from grasp_refine.scene.scene import Scene

FILE = resource_dir("robots") / "allegro/example_rounded_box.npz"


def boxed_example(candidates: int = 256) -> Scene:
    """The four grasps, on bodies with so many candidates."""
    grasps = load_grasps(FILE)
    hand, box = load_hand("allegro", candidates=candidates), load_object("rounded_box", candidates=candidates)
    return Scene(hand, box, transform_from_pose(grasps.hand_pose), grasps.q)
