"""The command line that asks for the same again, as documents carry it."""

import shlex

import pytest

from grasp_refine_apps.commands.batch import Batch
from grasp_refine_apps.commands.bench_align import BenchAlign
from grasp_refine_apps.commands.bench_grasp import BenchGrasp
from grasp_refine_apps.commands.bench_success import BenchSuccess
from grasp_refine_apps.commands.options import parse
from grasp_refine_apps.report.command_line import invocation


@pytest.mark.parametrize(
    ("command", "options"),
    [
        (BenchAlign, ""),
        (BenchAlign, "--no-transport --margins 0.0 0.001"),
        (BenchAlign, "--methods rigid distance --transport --step-sizes 1.0 --seed 3"),
        (BenchGrasp, ""),
        (BenchGrasp, "--object sphere:0.03 --solvers adam descent --shift 0.0"),
        (BenchGrasp, "--hand 'my hand.urdf' --batches 1 2"),
        (BenchSuccess, ""),
        (BenchSuccess, "--index 0 3 --grasps mine.npz --starts 1 24 --protocols strict"),
        (Batch, "mine.npz --levenberg-marquardt.damping 3.0 --weights.contact 2.0"),
    ],
)
def test_the_same_is_asked_for_again(command: type[BenchAlign | BenchGrasp | BenchSuccess | Batch], options: str):
    asked = parse(command, "bench", [*shlex.split(options), "--json", "a.json"])
    program, *words = shlex.split(invocation("bench mine", asked))
    assert (program, words[:2]) == ("refine-grasp", ["bench", "mine"])
    assert shlex.join(words[2:]) == options
    assert "--json" not in words
    again = parse(command, "bench", words[2:])
    assert invocation("bench mine", again) == invocation("bench mine", asked)
