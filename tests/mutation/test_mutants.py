"""Planted faults: one expression each, read by child processes too, while the source file stays."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from grasp_refine.core import plurals
from mutation.__main__ import main
from mutation.mutants import mutants

CODE = """
from __future__ import annotations
def length(x: list[float] = None, axis=0) -> float | None:
    "Return x / 2, in °."
    if TYPE_CHECKING:
        return 1 + 1
    if not x:
        raise ValueError(f"{x + 1} < 2")
    return -max(x[1] * 2.0, key=f) if axis < 3 else "é" + x.T
"""


def test_each_fault_changes_one_expression_that_runs(tmp_path: Path):
    path = tmp_path / "code.py"
    path.write_text(CODE, encoding="utf-8")
    found = {str(mutant).partition(": ")[2] for mutant in mutants(path)}
    assert found == {
        "0  ->  (1)",
        "not x  ->  (x)",
        "axis < 3  ->  (axis <= 3)",
        "3  ->  (4)",
        '-max(x[1] * 2.0, key=f) if axis < 3 else "é" + x.T'
        "  ->  ('é' + x.T if axis < 3 else -max(x[1] * 2.0, key=f))",
        "-max(x[1] * 2.0, key=f)  ->  (max(x[1] * 2.0, key=f))",
        "max(x[1] * 2.0, key=f)  ->  (min(x[1] * 2.0, key=f))",
        "x[1] * 2.0  ->  (x[1] / 2.0)",
        "1  ->  (2)",
        "2.0  ->  (3.0)",
        "\"é\" + x.T  ->  ('é' - x.T)",
        "x.T  ->  (x)",
    }
    for mutant in mutants(path):
        compile(mutant.source(), "code.py", "exec")
    assert {mutant.text for mutant in mutants(path, {7})} == {"(x)"}


def test_a_planted_fault_is_seen_by_the_processes_that_tests_start(tmp_path: Path):
    source = Path(plurals.__file__).read_text()
    (tmp_path / "changed.py").write_text(source + "\nPLANTED = True\n")
    environment = os.environ | {
        "PYTHONPATH": os.pathsep.join([str(Path(__file__).parent / "hook"), *filter(None, sys.path)]),
        "MUTANT_MODULE": plurals.__name__,
        "MUTANT_SOURCE": str(tmp_path / "changed.py"),
    }
    script = "import subprocess, sys; sys.exit(subprocess.call([sys.executable, '-c', sys.argv[1]]))"
    inner = f"import {plurals.__name__} as m; assert m.PLANTED and m.__file__.endswith('plurals.py')"
    assert subprocess.run([sys.executable, "-c", script, inner], env=environment).returncode == 0
    assert not hasattr(plurals, "PLANTED")


@pytest.mark.slow
def test_caught_and_surviving_faults_are_counted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    monkeypatch.chdir(Path(__file__).parents[2])
    test = tmp_path / "test_plurals.py"
    test.write_text(
        "from grasp_refine.core.plurals import count_text\n"
        "def test_one():\n    assert count_text(1, 'grasp') == '1 grasp'\n"
    )
    faults = "\n".join(
        f"[[fault]]\nfile = 'grasp_refine/core/plurals.py'\nold = '''{old}'''\nnew = '''{new}'''"
        for old, new in (("== 1", "== 2"), ("from __future__", "\n\nfrom __future__"))
    )
    (tmp_path / "faults.toml").write_text(faults)
    arguments = ["mutation", "--faults", str(tmp_path / "faults.toml"), "--tests", str(test), "--count", "0"]
    monkeypatch.setattr(sys, "argv", arguments)
    assert main() == 1
    printed = capsys.readouterr().out
    assert "caught   grasp_refine/core/plurals.py:" in printed and "by " in printed
    assert printed.split("\nall ")[1].split()[:3] == ["1", "0", "1"]
