"""Minimise a function of torch tensors beside our loss: here the hand holds the object near its top."""

import torch

import grasp_refine as gr

HEIGHT = 0.03  # metres above the object's origin


def near_the_top(state: gr.State, scene: gr.Scene) -> torch.Tensor:
    """Residuals (M, L): heights of the touching points of the fingertips away from the wanted one, in metres."""
    tips = [scene.links.index(contact.link) for contact in scene.hand.contacts]
    return state.witness.point_b[:, tips, 2] - HEIGHT  # points on the object, world frame


hand, box = gr.load_hand("allegro"), gr.load_object("box:0.06,0.05,0.09")
grasps = gr.sample_grasps(hand, box, 4, seed=2)
term = gr.TorchTerm(near_the_top, weight=0.5)

plain = gr.refine(hand, box, grasps)
refined = gr.refine(hand, box, grasps, terms=[term])
for name, found in (("without", plain), ("with", refined)):
    heights = found.outcome.contact_point_object[..., 2]
    print(f"{name} the term: contacts {1e3 * abs(heights[found.outcome.touching] - HEIGHT).mean():.1f} mm from it")
