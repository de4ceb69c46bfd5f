"""Refine grasps on several objects, and write one table of all; what cannot be refined is listed, and the rest goes on.

For many files, `refine-grasp batch` does it in parallel, and goes on where it was stopped.
"""

import csv
from pathlib import Path

import grasp_refine as gr

OBJECTS = {"mug": "mug", "bottle": "bottle", "box": "box:0.06,0.05,0.09", "missing": "missing.obj"}

hand, rows, failed = gr.load_hand("allegro"), list[dict[str, object]](), dict[str, str]()
Path("refined").mkdir(exist_ok=True)
for name, source in OBJECTS.items():
    try:
        thing = gr.load_object(source)
        refined = gr.refine(hand, thing, gr.sample_grasps(hand, thing, 2, seed=0), gr.Config(starts=1))
    except gr.GraspRefineError as error:
        failed[name] = str(error)
        continue
    refined.save(f"refined/{name}.npz", overwrite=True)
    for quality, status in zip(refined.quality[:, 1].tolist(), refined.status.tolist(), strict=True):
        rows.append({"object": name, "quality": quality, "status": status})

with Path("refined/index.csv").open("w", newline="") as file:
    writer = csv.DictWriter(file, ("object", "quality", "status"))
    writer.writeheader()
    writer.writerows(rows)
print(f"{len(rows)} grasps on {len(OBJECTS) - len(failed)} objects; failed: {failed}")
