"""Compilation of an MJCF in a child process first, bounded in time and memory: a short file can demand any amount."""

from __future__ import annotations

import sys
from functools import lru_cache
from pathlib import Path

from grasp_refine.core.child import limit_child, run_module
from grasp_refine.core.errors import HandError
from grasp_refine.hands.files.mjcf_xml import named_xml

MAX_PROCESSOR_S = 10.0
"""Maximum processor time in seconds; hands take up to 3."""

MAX_MEMORY_BYTES = 2**32
"""Maximum address space, 4 GiB; MuJoCo alone takes 1 GiB, hands some 100 MiB more."""

_REFUSED = 3


def try_out(path: Path) -> None:
    """Compile an MJCF in a child process, once for each version of the file.

    Errors that MuJoCo reports of the file are left to be reported by this process.

    Raises:
        HandError: that takes too long, too much memory, or crashes.
    """
    stat = path.stat()
    fault = _fault(path, stat.st_mtime_ns, stat.st_size)
    if fault:
        raise HandError(f"{path}: {fault}")


@lru_cache
def _fault(path: Path, changed: int, size: int) -> str:
    end = run_module(__name__, str(path), processor_s=MAX_PROCESSOR_S, memory_bytes=MAX_MEMORY_BYTES)
    if end.code == 0:
        return ""
    if end.out_of_time:
        return f"MuJoCo takes more than {MAX_PROCESSOR_S:g} s to compile it: too much for one hand"
    if end.code == _REFUSED:
        return f"MuJoCo cannot compile it within {MAX_MEMORY_BYTES >> 30} GiB of memory, too much for one hand"
    return f"MuJoCo crashes on it ({end.fault})"


def _main(limits: str, path: str) -> int:
    """Run the child process."""
    limit_child(limits)
    import mujoco

    mujoco.set_mju_user_warning(lambda message: None)
    try:
        file, text = named_xml(Path(path))
        spec = mujoco.MjSpec.from_file(file, include=text)
        for material in spec.materials:
            material.textures = [""] * len(material.textures)
        for texture in list(spec.textures):
            spec.delete(texture)
        spec.compile()
    except ValueError as error:
        # Any other fault of the file is that of what this process left in it, or is reported again.
        return _REFUSED if "alloc" in str(error) or "memory" in str(error) else 0
    except Exception:
        # Of memory that is not there MuJoCo says nothing else than "unknown exception".
        return _REFUSED
    return 0


if __name__ == "__main__":
    sys.exit(_main(*sys.argv[1:]))
