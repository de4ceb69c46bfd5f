"""Cut the embedded objects into the convex pieces that come with the program.

Run `python -m grasp_refine_apps.authoring.cut_embedded` after a change of `geometry/shapes.py` or of the defaults of
`Decomposition`. The pieces are of a mesh of diagonal 1, named by its content, and serve every scale.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from grasp_refine.geometry.cache import save
from grasp_refine.geometry.pieces import SHIPPED, unit_pieces
from grasp_refine.geometry.shapes import EMBEDDED
from grasp_refine.objects.object import load_object


def main(arguments: list[str] | None = None) -> None:
    """Write the pieces of each embedded object that is not convex, and remove all others."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=SHIPPED, help=f"folder to write to [{SHIPPED}]")
    out = parser.parse_args(arguments).out
    concave = [obj for obj in map(load_object, EMBEDDED) if not obj.convex]
    made = dict(unit_pieces(obj.mesh, name=obj.name) for obj in concave)
    for path in out.glob("*.npz"):
        path.unlink()
    for entry, pieces in made.items():
        save(out / entry, pieces)
        (out / entry).chmod(0o644)  # as all files of the program, whoever reads them
        print(f"{out / entry}: {len(pieces)} pieces")


if __name__ == "__main__":
    main()
