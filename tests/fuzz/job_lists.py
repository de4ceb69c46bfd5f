"""Job lists of batches, as TOML and as CSV."""

from __future__ import annotations

from collections.abc import Hashable
from pathlib import Path
from random import Random

from fuzz.mutations import VALUES
from fuzz.reader import Reader, plain, written
from fuzz.toml import WORDS, changed_toml, toml
from grasp_refine_apps.batch.jobs import KEYS, read_jobs
from grasp_refine_apps.commands.inputs import Inputs

JOBS = {
    "defaults": {"hand": "shadow", "scale": 0.1},
    "job": [
        {"name": "all", "grasps": "sets/*.npz", "objects": "meshes"},
        {"grasps": "sets/a.npz", "object": "box:1,1,1", "targets": "auto", "unit": "mm"},
        {"grasps": "sample:4", "hand": "allegro", "object": "mug"},
    ],
}
CSV = b"name,hand,object,grasps,scale,unit\nfirst,shadow,mug,sets/a.npz,1.5,mm\n,allegro,,sets/*.npz,,\n,,,sample:3,,\n"
STARS = ("sets", "sets/**", "**/*.npz", "../*", "/etc/*", "~/x", "sets/[a-", "sample:", "sample:x", "meshes", *KEYS)


def seeds() -> list[tuple[str, bytes]]:
    """A list of each kind."""
    return [("jobs.toml", toml(JOBS)), ("jobs.csv", CSV)]


def prepare(folder: Path) -> None:
    """What they name."""
    written(folder, {"sets/a.npz": b"x", "sets/b.npz": b"x", "meshes/mug.obj": b"x", "list/inner.csv": CSV})


def change(random: Random, name: str, content: bytes) -> bytes:
    """Another value in a table or a cell."""
    if name.endswith(".toml"):
        # A list may well ask for all grasps of the machine, which takes a while.
        return changed_toml(STARS)(random, name, content).replace(b'"/"', b'"/nothing"')
    lines = [line.split(b",") for line in content.split(b"\n")]
    line = random.choice(lines)
    text = random.choice((*STARS, *(value for value in VALUES if isinstance(value, str) and value != "/")))
    line[random.randrange(len(line))] = random.choice((text, f'"{text}"', f'"{text}')).encode(errors="replace")
    return b"\n".join(map(b",".join, lines))


def read(path: Path) -> Hashable:
    """The jobs."""
    jobs = read_jobs([str(path)], Inputs())
    names = [job.name for job in jobs]
    assert len(set(names)) == len(names) and all(name.strip("/") for name in names), names
    for name in names:
        plain(name)
    return len(jobs), tuple(sorted({job.named for job in jobs}))


READER = Reader("job list", seeds, read, change, (*WORDS, b",", b'"', b"\r\n", b"\xef\xbb\xbf"), prepare)
