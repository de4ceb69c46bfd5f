"""Skips at the start of the program: pairs that never meet, decomposition of convex objects, imports."""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path

import numpy as np

import grasp_refine
from grasp_refine.geometry.decomposition import Decomposition, decompose
from grasp_refine.geometry.pieces import convex_pieces
from grasp_refine.hands.hand import Hand
from grasp_refine.hands.self_collision import Sampling, candidate_pairs, judged_pairs, self_penetration, touching_pairs
from grasp_refine.objects.object import Object
from grasp_refine_apps.bench.queries.skip import Skip, measure_calls

NUM_CONFIGURATIONS = 512
"""Number of random configurations at which pairs of links are queried."""

PROGRAM = """
import contextlib, io, json, pkgutil, sys, time
everything, arguments = json.loads(sys.argv[1]), sys.argv[2:]
if everything:
    from importlib import import_module
    import grasp_refine, grasp_refine_apps
    for package in (grasp_refine, grasp_refine_apps):
        for module in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
            if not module.name.endswith("__main__"):
                with contextlib.suppress(ImportError):
                    import_module(module.name)
    for name in ("coacd", "matplotlib.figure", "jinja2"):
        with contextlib.suppress(ImportError):
            import_module(name)
from grasp_refine_apps.cli import main
with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
    code = main(arguments)
print(json.dumps([code, len(sys.modules)]))
"""
"""Runs a command line in a process of its own, optionally after loading everything; prints the number of modules."""

COMMANDS = ("--help", "hands", "run --no-validate")
"""Default command lines whose imports are counted."""


def self_collision_skips(hand: Hand, seed: int, rounds: int) -> Iterator[Skip]:
    """Measure the skip of link pairs that never meet within the joint limits, and of finding them at a second start."""
    judged = judged_pairs(hand)
    apart = sorted(set(candidate_pairs(hand)) - {*judged.at_rest, *judged.nearly_always})
    q = np.random.default_rng(seed).uniform(*_limits(hand), (NUM_CONFIGURATIONS, len(hand.joint_names)))
    both = {"without": apart, "with": judged.watched}
    asked = measure_calls(
        {which: partial(self_penetration, hand, pairs, q) for which, pairs in both.items()}, rounds + 1
    )
    yield Skip(
        "pairs of links that never meet within the limits", "link pairs", f"{hand.name}, batch {NUM_CONFIGURATIONS}",
        len(apart), len(judged.watched), asked["without"][1], asked["with"][1],
        "all pairs that do not overlap by design are queried",
    )  # fmt: skip
    with tempfile.TemporaryDirectory(prefix="grasp-refine-") as folder:
        look = partial(touching_pairs, hand, cache=Path(folder))
        # In this order: the first one fills the folder.
        found = measure_calls({"without": look, "with": look})
    yield Skip(
        "looking for these pairs at the second start", "configurations", hand.name,
        1 + Sampling.uniform + Sampling.extreme, 0, found["without"][1], found["with"][1],
        "the first start, with an empty cache",
    )  # fmt: skip


def _limits(hand: Hand) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper limits (n,), one turn where a joint is continuous."""
    return np.maximum(hand.lower, -np.pi), np.minimum(hand.upper, np.pi)


def decomposition_skip(obj: Object) -> Skip:
    """Measure the skip of decomposing a convex object, which is its own hull: CoACD does not run."""
    mesh = obj.mesh
    vertices = np.asarray(mesh.vertices) / np.linalg.norm(np.ptp(mesh.vertices, axis=0))
    found = measure_calls(
        {
            "with": lambda: convex_pieces(mesh, name=obj.name),
            "without": lambda: decompose(vertices, np.asarray(mesh.faces), Decomposition(), single=True),
        }
    )
    parts, pieces = len(found["without"][0]), len(found["with"][0])
    return Skip(
        "decomposition of convex objects", "runs of CoACD", obj.name, 1, 0, found["without"][1], found["with"][1],
        f"CoACD runs, and makes {parts} piece{'s' * (parts != 1)} instead of {pieces}",
    )  # fmt: skip


def import_skips(commands: Sequence[str]) -> Iterator[Skip]:
    """Measure the modules that a command does not load, each in processes of their own."""
    for command in commands:
        ways = {"with": False, "without": True}
        found = measure_calls(
            {which: partial(_modules, command.split(), everything) for which, everything in ways.items()}
        )
        yield Skip(
            "unused imports", "modules", f"refine-grasp {command}", found["without"][0], found["with"][0],
            found["without"][1], found["with"][1], "the whole package is imported first",
        )  # fmt: skip


def _modules(command: Sequence[str], everything: bool) -> int:
    """Count the modules that are loaded at the end of a command."""
    with tempfile.TemporaryDirectory(prefix="grasp-refine-") as folder:
        sources = [str(Path(grasp_refine.__file__).parents[1]), str(Path(__file__).parents[3])]
        child = subprocess.run(
            [
                sys.executable,
                "-c",
                f"import sys; sys.path += {sources!r}\n{PROGRAM}",
                json.dumps(everything),
                *command,
            ],
            cwd=folder,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
        )
    assert child.returncode == 0, child.stderr
    code, modules = json.loads(child.stdout.strip().splitlines()[-1])
    assert code == 0, f"refine-grasp {' '.join(command)} ended with exit code {code}"
    return modules
