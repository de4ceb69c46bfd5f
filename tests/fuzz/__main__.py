"""Fuzz readers and print a table: `PYTHONPATH=tests python -m fuzz --seconds S --seed N --keep DIR READER ..`."""

from __future__ import annotations

import argparse
import re
import sys
import time
from importlib import import_module
from pathlib import Path


def main() -> int:
    """Fuzz the readers; 1 where there is a finding."""
    if sys.argv[1:2] == ["--child"]:
        from fuzz.child import run

        module, reader, folder, seed, seconds, most = sys.argv[2:]
        run(import_module(module).READERS[reader], Path(folder), int(seed), float(seconds), int(most))
        return 0
    from fuzz.readers import READERS
    from fuzz.runner import fuzz

    parser = argparse.ArgumentParser(prog="python -m fuzz", description="Feed readers changed files.")
    parser.add_argument("readers", nargs="*", metavar="READER", help=f"of {', '.join(READERS)}; none: all")
    parser.add_argument("--seconds", type=float, default=60.0, help="for each reader (default: 60)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--keep", type=Path, default=None, help="folder for the inputs of findings")
    options = parser.parse_args()
    if unknown := [name for name in options.readers if name not in READERS]:
        parser.error(f"no reader {unknown[0]}; there are {', '.join(READERS)}")
    found = 0
    print(f"{'reader':12s} {'executions':>10s} {'refused':>8s} {'endings':>8s} {'findings':>8s}")
    for name in options.readers or READERS:
        outcome = fuzz(name, seed=options.seed, seconds=options.seconds)
        found += len(outcome.findings)
        counts = f"{outcome.executions:10d} {outcome.refused:8d} {outcome.endings:8d}"
        print(f"{name:12s} {counts} {len(outcome.findings):8d}", flush=True)
        for finding in outcome.findings:
            print(f"  {finding.kind}: {finding.where}: {' '.join(finding.details.split())[-160:]}", flush=True)
            if options.keep is not None:
                options.keep.mkdir(parents=True, exist_ok=True)
                stem = re.sub(r"\W+", "_", f"{name} {finding.kind} {finding.where}")[:80]
                path = options.keep / f"{stem}-{time.strftime('%H%M%S')}"
                path.with_suffix(Path(finding.name).suffix or ".bin").write_bytes(finding.content)
                path.with_suffix(".said").write_text(f"{finding.name}\n{finding.details}", encoding="utf-8")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
