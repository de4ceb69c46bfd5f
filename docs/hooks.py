"""Hooks of the documentation: pages that are made of the program itself, pictures beside the code, and formulas.

MkDocs calls `on_files` once, before it reads any page, and `on_page_content` with the HTML of each page.
"""

from __future__ import annotations

import ast
import re
import warnings
from html import unescape
from importlib import import_module
from pathlib import Path
from typing import Any

from latex2mathml.converter import convert
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

ROOT = Path(__file__).resolve().parents[1]

BESIDE_THE_CODE = {
    "changelog.md": "CHANGELOG.md",
    "pictures/example.png": "robots/allegro/example.png",
    "pictures/overview.png": "apps/grasp_refine_apps/viewer/overview.png",
    "pictures/replay.png": "apps/grasp_refine_apps/viewer/replay.png",
}
"""Path in the site -> file elsewhere in the repository."""

PYTHON_PAGES = (
    "hands", "objects", "grasps", "refinement", "collision", "witness", "forces", "validation", "core",
)  # fmt: skip
"""Pages of the Python reference, in `reference/python`."""

FORMULA = re.compile(r'<(span|div) class="arithmatex">\\[(\[](.*?)\\[)\]]</\1>', re.DOTALL)
"""A formula in TeX, as the extension arithmatex marks it."""


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add what is not written by hand: the references, and files that live beside the code."""
    for target, source in BESIDE_THE_CODE.items():
        files.append(File.generated(config, target, abs_src_path=str(ROOT / source)))
    files.append(File.generated(config, "reference/commands.md", content=_commands()))
    files.append(File.generated(config, "reference/python/index.md", content=_names(files)))
    return files


def on_page_content(html: str, **_: Any) -> str:
    """Turn formulas into MathML, which browsers draw without any script."""
    return FORMULA.sub(
        lambda found: convert(unescape(found[2]), display="block" if found[1] == "div" else "inline"), html
    )


def _commands() -> str:
    """Page with a section for each command: its docstring, and a table of its options for each group of them."""
    from grasp_refine_apps.cli import COMMANDS, PROGRAM

    parts = [
        "# Commands",
        f"`{PROGRAM} COMMAND --help` prints the same. The exit code is 0 when done, 1 when nothing usable came out, 2 "
        "for bad input, with one line that says what to do, and 130 when interrupted: Ctrl-C, SIGTERM and a closed "
        "terminal end a command and everything that it started.",
        "| Command | |\n|---|---|",
    ]
    parts[-1] += "".join(f"\n| [`{name}`](#{_anchor(name)}) | {_cell(what)} |" for name, what in COMMANDS.items())
    for name, what in COMMANDS.items():
        parts += _command(name, what)
    return "\n\n".join(parts) + "\n"


def _command(name: str, what: str) -> list[str]:
    """Paragraphs on a command."""
    import tyro

    from grasp_refine_apps.commands.option_rules import OptionRules

    words = name.replace("--", "").split()
    module = import_module(f"grasp_refine_apps.commands.{'_'.join(words)}")
    with warnings.catch_warnings():
        # The only public way to what a parser knows.
        warnings.simplefilter("ignore", DeprecationWarning)
        command = getattr(module, "".join(map(str.capitalize, words)))
        parser = tyro.extras.get_parser(command, registry=OptionRules((), everything=True))
    parts = [f"## {name} {{: #{_anchor(name)} }}", parser.description or what]
    for group in parser._action_groups:
        rows = [row for action in group._group_actions if (row := _option(action))]
        if not rows:
            continue
        if group.title not in ("options", "positional arguments"):
            parts += [f"**{group.title[:1].upper()}{group.title[1:]}.** {group.description or ''}"]
        parts += ["\n".join(["| Option | Meaning | Default |", "|---|---|---|", *rows])]
    return parts


def _option(action: Any) -> str | None:
    """Row of the table for an option; None for --help."""
    if action.dest == "help" or not action.help:
        return None
    said, _, default = " ".join(action.help.split()).rpartition(" (default: ")
    if not said:
        said, default = default, ")"
    name = action.option_strings[0] if action.option_strings else ""
    value = action.metavar if isinstance(action.metavar, str) else " ".join(action.metavar or ())
    # A long list of choices has to break.
    words = [f"`{part}`" for part in re.split(r"(?<=,)", f"{name} {value}".strip())]
    return f"| {'<wbr>'.join(words)} | {_cell(said)} | {_cell(default.removesuffix(')'))} |"


def _names(files: Files) -> str:
    """Page with the public names of the modules in the Python reference, and the first line of each docstring."""
    parts = [
        "# Python reference",
        "Shapes, units, frames and errors stand in the docstrings, here and in `help()`. "
        "[Conventions](../../concepts/conventions.md) hold in all of them.",
    ]
    for page in PYTHON_PAGES:
        text = next(file for file in files if file.src_uri == f"reference/python/{page}.md").content_string
        parts += [f"## {text.partition('# ')[2].partition(chr(10))[0]}", "| Name | |\n|---|---|"]
        for module in re.findall(r"^::: (\S+)$", text, re.MULTILINE):
            source = ROOT.joinpath(*module.split(".")).with_suffix(".py").read_text(encoding="utf-8")
            for node in ast.parse(source).body:
                if isinstance(node, ast.FunctionDef | ast.ClassDef) and not node.name.startswith("_"):
                    first = (ast.get_docstring(node) or "").partition("\n")[0]
                    parts[-1] += f"\n| [`{node.name}`][{module}.{node.name}] | {_cell(first)} |"
    return "\n\n".join(parts) + "\n"


def _anchor(name: str) -> str:
    return name.replace("--", "").replace(" ", "-")


def _cell(text: str) -> str:
    """Text in a cell of a table."""
    return text.replace("|", "\\|")
