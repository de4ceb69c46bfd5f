"""Plant subtle faults, one after the other, and run the nearest tests: `PYTHONPATH=tests python -m mutation FILE ..`.

Source files stay as they are: the processes of the tests, and those that they start, read the changed module from
elsewhere.
"""

from __future__ import annotations

import argparse
import os
import random
import re
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

from mutation.mutants import Mutant, listed, mutants
from mutation.nearest import ROOTS, module_name, nearest_tests

HOOK = Path(__file__).parent / "hook"


def main() -> int:
    """Print each fault that no test catches, and a table; 1 where there is one."""
    parser = argparse.ArgumentParser(prog="python -m mutation", description=__doc__.splitlines()[0])
    parser.add_argument("files", nargs="*", type=Path, metavar="FILE", help="source files, or folders of them")
    parser.add_argument("--changed", metavar="COMMIT", help="lines changed since this commit, such as main")
    parser.add_argument("--faults", type=Path, metavar="TOML", help="faults to plant: [[fault]] file, old, new")
    parser.add_argument("--count", type=int, default=20, help="faults drawn of all files together (default: 20)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--seconds", type=float, default=120.0, help="for the tests of a fault (default: 120)")
    parser.add_argument("--tests", nargs="+", default=[], help="these in place of the nearest tests")
    options = parser.parse_args()

    found = listed(options.faults) if options.faults else []
    drawn = [fault for file in _sources(options.files) for fault in mutants(file)]
    if options.changed:
        drawn += [fault for file, lines in _changed(options.changed).items() for fault in mutants(file, lines)]
    random.Random(options.seed).shuffle(drawn)
    found += sorted(drawn[: options.count], key=lambda fault: (fault.path, fault.start))
    if not found:
        parser.error("no faults: name source files, --changed COMMIT or --faults TOML")

    outcomes: dict[Path, Counter[str]] = {}
    start = time.monotonic()
    for fault in found:
        tests = options.tests or nearest_tests(fault.path)
        if fault.path not in outcomes:
            outcomes[fault.path] = Counter()
            if (end := _run(tests, None, options.seconds)) != "survived":
                print(f"{fault.path}: its tests fail or take too long without a fault ({end}): {' '.join(tests)}")
                return 2
        end = _run(tests, fault, options.seconds)
        outcomes[fault.path][end.split()[0]] += 1
        print(f"{end.split()[0]:8s} {fault}{end.removeprefix(end.split()[0])}", flush=True)

    total = sum(outcomes.values(), Counter())
    print(f"\n{'file':60s} {'caught':>7s} {'timeout':>8s} {'survived':>9s}")
    for name, counts in (*((str(path), counts) for path, counts in outcomes.items()), ("all", total)):
        print(f"{name:60s} {counts['caught']:7d} {counts['timeout']:8d} {counts['survived']:9d}")
    print(f"{time.monotonic() - start:.0f} s")
    return 1 if total["survived"] else 0


def _run(tests: list[str], fault: Mutant | None, seconds: float) -> str:
    """Run tests until one fails: "caught", with its name, "timeout" or "survived"."""
    with tempfile.TemporaryDirectory(prefix="mutation-") as folder:
        environment = dict(os.environ)
        if fault is not None:
            source = Path(folder) / fault.path.name
            source.write_text(fault.source(), encoding="utf-8")
            environment |= {
                "PYTHONPATH": os.pathsep.join([str(HOOK), *filter(None, [os.environ.get("PYTHONPATH")])]),
                "MUTANT_MODULE": module_name(fault.path),
                "MUTANT_SOURCE": str(source),
            }
        command = [sys.executable, "-m", "pytest", "-x", "-q", "-n0", "-p", "no:cacheprovider", *tests]
        process = subprocess.Popen(
            command,
            env=environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            start_new_session=True,
        )
        try:
            output = process.communicate(timeout=seconds)[0]
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, 9)
            process.communicate()
            return "timeout"
    if process.returncode == 0:
        return "survived"
    first = re.search(r"^(?:FAILED|ERROR) (\S+)", output, re.MULTILINE)
    return f"caught by {first[1] if first else 'an error'}"


def _sources(paths: list[Path]) -> list[Path]:
    """Return the source files among paths relative to the checkout, and in folders."""
    files = [file for path in paths for file in (sorted(path.rglob("*.py")) if path.is_dir() else [path])]
    return [file for file in files if any(file.is_relative_to(root) for root in ROOTS)]


def _changed(commit: str) -> dict[Path, set[int]]:
    """Return the lines of source files that are new or changed since a commit."""
    command = ["git", "diff", "--unified=0", commit, "--", *map(str, ROOTS)]
    text = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    lines: dict[Path, set[int]] = {}
    path = Path()
    for line in text.splitlines():
        if line.startswith("+++ "):
            path = Path(line[6:])
        elif (hunk := re.match(r"@@ -\S+ \+(\d+)(?:,(\d+))? @@", line)) and path.suffix == ".py":
            first, count = int(hunk[1]), int(hunk[2] or 1)
            lines.setdefault(path, set()).update(range(first, first + count))
    return {path: numbers for path, numbers in lines.items() if numbers}


if __name__ == "__main__":
    sys.exit(main())
