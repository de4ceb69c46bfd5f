"""Console script `refine-grasp`: finds the command, runs it, and turns errors into one line and an exit code.

Only names and one-line descriptions of the commands are known here, so that `--help` is instant. A command is a
module of `commands`, loaded when it is chosen; its class of the same name holds the options and has `execute`.
The module of a command of two words joins them: `bench align` is `commands/bench_align.py` with `BenchAlign`.

Exit codes: 0 done, 1 no usable results, 2 bad input, 130 interrupted, 141 broken output pipe.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from difflib import get_close_matches
from errno import ENAMETOOLONG
from importlib import import_module
from io import TextIOWrapper
from typing import NoReturn

from grasp_refine.core.errors import GraspRefineError, visible
from grasp_refine.core.interruption import INTERRUPTED, interruptible

PROGRAM = "refine-grasp"

COMMANDS = {
    "run": "refine grasps of a hand on an object; without options, an embedded example",
    "transfer": "transfer grasps of one hand to another: the same fingers touch the same places",
    "batch": "refine whole datasets of grasps, in processes or on a cluster; resumes where it stopped",
    "validate": "test grasps of any file: geometry, and whether they hold in simulation",
    "view": "view grasps in a browser: watch their refinement, edit, validate, compare and export them",
    "convert": "convert grasp files of other programs to ours and back, checked by fingertip positions",
    "export": "write grasps for the programs that use them: MuJoCo, tables, with a README",
    "hands": "list the hands that ship with the program, or check a URDF",
    "scenes": "list the scenes that ship with the program, or check one of your own",
    "assets list": "list the hands, objects and grasps of others that can be fetched by name",
    "assets fetch": "fetch assets by name, each file checked; shows licence and citation",
    "assets verify": "check that fetched assets are complete and unchanged",
    "bench align": "run time against error of witness derivatives: the experiments of the paper",
    "bench grasp": "accuracy and speed of refinement, by solver and batch size",
    "bench queries": "cost of a witness query against coal and MuJoCo, and savings by skipping",
    "bench scans": "grasps refined on scans, on hulls, reconstructions and hypotheses, tried on the true object",
    "bench stability": "error counts of witness queries and derivatives, by body, size, state and method",
    "bench success": "grasps that hold in simulation, as given and refined; by hand, object, source and protocol",
    "bench transfer": "grasps of one hand as grasps of others: joint copy, inverse kinematics, transfer, tried",
    "bench --gate": "check for regressions: ratios of one run against a committed baseline",
    "doctor": "check the installation, missing packages, and the capabilities of this machine",
}
"""Name of each command -> description."""

BAD_INPUT, BROKEN_PIPE = 2, 141

THREADS = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
"""Environment variables set to 1: matrices are small here, and a second thread of linear algebra costs more than it
gains. Not OMP_NUM_THREADS: the child process that decomposes meshes would inherit it, and it does gain by threads."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command line; return its exit code.

    By default the arguments of the process, which then ends at once when interrupted, without returning.
    """
    of_process, arguments = arguments is None, sys.argv[1:] if arguments is None else list(arguments)
    if isinstance(sys.stdout, TextIOWrapper):
        # An arrow that the terminal cannot show is not worth an error.
        sys.stdout.reconfigure(errors="replace")
    if not arguments or arguments[0] in ("-h", "--help"):
        return _exit_code(lambda: _show(_usage()))
    if arguments[0] == "--version":
        from grasp_refine import __version__

        return _exit_code(lambda: _show(f"{PROGRAM} {__version__}"))
    name, rest = _command(arguments)
    if name in _groups() and (not rest or rest[0] in ("-h", "--help")):
        return _exit_code(lambda: _show(_usage(name)))
    if name not in COMMANDS:
        return _fail(_unknown(name), BAD_INPUT)
    for variable in THREADS:
        os.environ.setdefault(variable, "1")
    # MuJoCo only simulates here; a setting of OpenGL that it does not know would stop it.
    os.environ["MUJOCO_GL"] = "disable"
    if not of_process:
        return _exit_code(lambda: _run(name, rest))
    code = INTERRUPTED
    with interruptible(_end_interrupted) as interrupted:
        try:
            code = _exit_code(lambda: _run(name, rest))
        finally:
            if interrupted.is_set():
                # Python itself would first wait for threads, and take seconds to unload torch on a busy machine.
                _end(code)
    return code


def _show(text: str) -> int:
    print(text)
    return 0


def _run(name: str, rest: Sequence[str]) -> int:
    """Run a command with the options `rest`; return its exit code."""
    words = name.replace("--", "").split()
    command = getattr(
        import_module(f"grasp_refine_apps.commands.{'_'.join(words)}"), "".join(map(str.capitalize, words))
    )
    from grasp_refine_apps.commands.options import parse

    return parse(command, f"{PROGRAM} {name}", rest).execute()


def _exit_code(act: Callable[[], int]) -> int:
    """Return the exit code of `act`, whose errors become one line."""
    try:
        code = act()
        sys.stdout.flush()
        return code
    except GraspRefineError as error:
        from grasp_refine_apps.report.command_line import in_options

        return _fail(in_options(" ".join(str(error).split())), BAD_INPUT)
    except KeyboardInterrupt:
        return _fail("interrupted", INTERRUPTED)
    except BrokenPipeError:
        # Otherwise Python would complain once more when it flushes at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return BROKEN_PIPE
    except OSError as error:
        if error.errno != ENAMETOOLONG:
            raise
        return _fail(f"{str(error.filename)[:60]}...: the name is too long for a file", BAD_INPUT)


def _command(arguments: Sequence[str]) -> tuple[str, list[str]]:
    """Split a command line into the command, known or not, and the remaining arguments."""
    first, *rest = arguments
    if first in _groups() and rest and not rest[0].startswith("-"):
        return f"{first} {rest[0]}", rest[1:]
    # An option may be the second word, wherever it stands.
    for place, option in enumerate(rest):
        if option.startswith("--") and f"{first} {option}" in COMMANDS:
            return f"{first} {option}", rest[:place] + rest[place + 1 :]
    return first, rest


def _groups() -> set[str]:
    """First words of the commands that have two."""
    return {name.split()[0] for name in COMMANDS if " " in name}


def _usage(group: str = "") -> str:
    commands = {name: what for name, what in COMMANDS.items() if name.startswith(group)}
    width = max(map(len, commands))
    return "\n".join(
        [
            f"usage: {PROGRAM} COMMAND [OPTIONS]",
            "",
            "Refine grasps of robot hands: from grasps that are almost right to grasps that hold.",
            "",
            "commands:",
            *(f"  {name:<{width}}  {what}" for name, what in commands.items()),
            "",
            f"{PROGRAM} COMMAND --help shows the options of a command; {PROGRAM} --version the version.",
        ]
    )


def _unknown(name: str) -> str:
    kind = "option" if name.startswith("-") else "command"
    close = get_close_matches(name.lstrip("-"), [*COMMANDS, "help", "version"], n=1)
    known = f"the commands are {', '.join(COMMANDS)}"
    if not close:
        return f"no {kind} '{name}'; {known}"
    meant = close[0] if close[0] in COMMANDS else f"--{close[0]}"
    return f"no {kind} '{name}', did you mean {meant}? {known}"


def _end_interrupted() -> NoReturn:
    """End the process without the main thread, which may be deep in compiled code."""
    with suppress(OSError):
        _fail("interrupted", INTERRUPTED)
    _end(INTERRUPTED)


def _end(code: int) -> NoReturn:
    """End the process at once; child processes end with it (`interruption.end_with`)."""
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError):
            stream.flush()
    os._exit(code)


def _fail(message: str, code: int) -> int:
    print(f"{PROGRAM}: {'' if code == INTERRUPTED else 'error: '}{visible(message)}", file=sys.stderr)
    return code


if __name__ == "__main__":
    sys.exit(main())
