"""Child processes that are bounded."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from grasp_refine.core.child import run_module

MODULE = """
import sys
from grasp_refine.core.child import limit_child
limit_child(sys.argv[1])
what = sys.argv[2]
if what == "count":
    while True:
        pass
if what == "fill":
    bytearray(2**33)
if what == "fail":
    sys.exit("a fault")
"""


@pytest.fixture(autouse=True)
def module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The module `bounded_child` in the path."""
    (tmp_path / "bounded_child.py").write_text(MODULE)
    monkeypatch.syspath_prepend(tmp_path)


def test_processor_time_is_bounded() -> None:
    end = run_module("bounded_child", "count", processor_s=1.0)
    assert end.out_of_time


def test_memory_is_bounded() -> None:
    end = run_module("bounded_child", "fill", processor_s=20.0, memory_bytes=2**31)
    assert end.code == 1 and "MemoryError" in end.fault and not end.out_of_time


def test_a_fault_is_its_last_line() -> None:
    end = run_module("bounded_child", "fail", processor_s=20.0)
    assert end.fault == "exit code 1: a fault"
    assert run_module("bounded_child", "nothing", processor_s=float("inf")).code == 0


def test_scripts_need_no_guard(tmp_path: Path) -> None:
    """A script that calls it at its top level is not run again by the child."""
    script = tmp_path / "script.py"
    script.write_text(
        f"import sys\nsys.path.insert(0, {str(tmp_path)!r})\nfrom grasp_refine.core.child import run_module\n"
        "print(run_module('bounded_child', 'nothing', processor_s=9.0).code)\n"
    )
    assert subprocess.check_output([sys.executable, script], text=True) == "0\n"
