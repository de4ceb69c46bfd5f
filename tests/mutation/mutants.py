"""Subtle faults of a source file: each replaces one expression by one that is nearly right."""

from __future__ import annotations

import ast
import copy
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

COMPARISONS = {ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq}
COMPARISONS |= {ast.In: ast.NotIn, ast.NotIn: ast.In, ast.Is: ast.IsNot, ast.IsNot: ast.Is}
OPERATORS = {ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.BitAnd: ast.BitOr}
OPERATORS |= {ast.BitOr: ast.BitAnd, ast.FloorDiv: ast.Div, ast.Pow: ast.Mult}
PAIRS = ("min max", "sin cos", "any all", "argmin argmax", "minimum maximum", "floor ceil", "lower upper", "amin amax")
NAMES = {a: b for pair in PAIRS for a, b in (pair.split(), pair.split()[::-1])}


@dataclass(frozen=True)
class Mutant:
    """A fault: the text between two offsets of a file is another."""

    path: Path
    start: int
    end: int
    text: str

    def source(self) -> str:
        """Return the whole file with the fault."""
        whole = self.path.read_text(encoding="utf-8")
        return whole[: self.start] + self.text + whole[self.end :]

    def __str__(self) -> str:
        """Return file, line, and the text before and after."""
        whole = self.path.read_text(encoding="utf-8")
        before = " ".join(whole[self.start : self.end].split())
        return f"{self.path}:{whole.count(chr(10), 0, self.start) + 1}: {before}  ->  {' '.join(self.text.split())}"


def listed(path: Path) -> list[Mutant]:
    """Return the faults of a TOML file: [[fault]] with `file`, `old`, which is there once, and `new`."""
    found = []
    for fault in tomllib.loads(path.read_text(encoding="utf-8"))["fault"]:
        whole = Path(fault["file"]).read_text(encoding="utf-8")
        if (count := whole.count(fault["old"])) != 1:
            raise ValueError(f"{fault['file']}: {fault['old']!r} is there {count} times, not once")
        start = whole.index(fault["old"])
        found.append(Mutant(Path(fault["file"]), start, start + len(fault["old"]), fault["new"]))
    return found


def mutants(path: Path, lines: set[int] | None = None) -> list[Mutant]:
    """Return all faults of a file, of the lines in `lines` alone where there are any."""
    whole = path.read_text(encoding="utf-8")
    starts = [0]
    for line in whole.splitlines(keepends=True):
        starts.append(starts[-1] + len(line.encode()))
    data, found = whole.encode(), []
    for node in _nodes(ast.parse(whole)):
        if lines is not None and not lines & set(range(node.lineno, (node.end_lineno or node.lineno) + 1)):
            continue
        start = len(data[: starts[node.lineno - 1] + node.col_offset].decode())
        end = len(data[: starts[(node.end_lineno or node.lineno) - 1] + (node.end_col_offset or 0)].decode())
        for changed in _changes(node):
            text = ast.unparse(ast.fix_missing_locations(changed))
            found.append(Mutant(path, start, end, f"({text})" if isinstance(node, ast.expr) else text))
    return found


def _nodes(tree: ast.AST) -> Iterator[ast.expr | ast.AugAssign]:
    """Expressions and updates that run: no annotations, decorators, texts, nor what only type checkers read."""
    if isinstance(tree, ast.If) and ast.unparse(tree.test) == "TYPE_CHECKING":
        return
    for name, value in ast.iter_fields(tree):
        if name in ("annotation", "returns", "decorator_list", "bases", "keywords") and not isinstance(tree, ast.Call):
            continue
        for child in value if isinstance(value, list) else [value]:
            if isinstance(child, ast.JoinedStr | ast.Import | ast.ImportFrom | ast.Raise) or not isinstance(
                child, ast.AST
            ):
                continue
            if isinstance(child, ast.expr | ast.AugAssign):
                yield child
            yield from _nodes(child)


def _changes(node: ast.expr | ast.AugAssign) -> Iterator[ast.AST]:
    """Nodes that are nearly right in place of `node`."""
    new = copy.deepcopy(node)
    match new:
        case ast.Compare(ops=[op]) if type(op) in COMPARISONS:
            new.ops = [COMPARISONS[type(op)]()]
            yield new
        case ast.BinOp(op=ast.MatMult()):
            new.left, new.right = new.right, new.left
            yield new
        case ast.BinOp(op=op) | ast.AugAssign(op=op) if type(op) in OPERATORS:
            new.op = OPERATORS[type(op)]()
            yield new
        case ast.UnaryOp(op=ast.USub() | ast.Not()):
            yield new.operand
        case ast.BoolOp(op=op):
            new.op = ast.And() if isinstance(op, ast.Or) else ast.Or()
            yield new
            yield new.values[0]
        case ast.Constant(value=bool(value)):
            yield ast.Constant(not value)
        case ast.Constant(value=int(value)):
            yield ast.Constant(value + 1)
        case ast.Constant(value=float(value)):
            yield ast.Constant(value * 1.5 if value else 0.01)
        case ast.Attribute(attr="T" | "mT"):
            yield new.value
        case ast.Attribute(attr=name) if name in NAMES:
            new.attr = NAMES[name]
            yield new
        case ast.Call(func=ast.Name(id=name)) if name in NAMES:
            new.func = ast.Name(NAMES[name])
            yield new
        case ast.Call(keywords=[*_, last]):
            yield ast.Call(new.func, new.args, [keyword for keyword in new.keywords if keyword is not last])
        case ast.IfExp():
            new.body, new.orelse = new.orelse, new.body
            yield new
