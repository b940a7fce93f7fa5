"""Functions of a module or of the driver for one trajectory, without lanes and layout.

The texts are those that are walked and compiled. Their columns are lanes; in C there is one, so
that an index of a lane, a loop over lanes and an argument that names one say nothing. What the
driver gets of the layout, ``at[NAME]``, is a constant of this module.
"""

from __future__ import annotations

import ast
import copy
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, cast

#: Arguments that say nothing where there is one lane.
DROPPED = ("lane", "at")
#: The workspace, and how the driver asks for the number of its rows.
WORKSPACE, ROWS = "W", "W.shape[0]"


@dataclass(frozen=True)
class Source:
    """Functions that name the same constants: those of a module, or those of the driver."""

    functions: Mapping[str, ast.FunctionDef]
    constants: Mapping[str, Any]  #: Numbers, tuples or arrays.
    driver_layout: Mapping[str, int]  #: What ``at[NAME]`` is.
    lines: list[str]  #: Lines of the text, for its comments.


@dataclass(frozen=True)
class Function:
    """A function with one lane."""

    name: str
    doc: str
    arguments: tuple[str, ...]
    body: list[ast.stmt]
    source: Source


class Functions(Mapping[str, Function]):
    """Functions of some sources by name, each read when it is first asked for."""

    def __init__(self, sources: Sequence[Source]) -> None:
        self._source = {name: source for source in sources for name in source.functions}
        self._read: dict[str, Function] = {}

    def __getitem__(self, name: str) -> Function:
        if name not in self._read:
            self._read[name] = plain_function(name, self._source[name])
        return self._read[name]

    def __contains__(self, name: object) -> bool:
        return name in self._source

    def __iter__(self) -> Iterator[str]:
        return iter(self._source)

    def __len__(self) -> int:
        return len(self._source)


def plain_function(name: str, source: Source) -> Function:
    """Read a function for one lane."""
    node = source.functions[name]
    arguments = [argument.arg for argument in node.args.args if argument.arg not in DROPPED]
    if "workspace" in arguments:  # a kernel, which makes an array of it
        arguments[arguments.index("workspace")] = WORKSPACE
    doc = ast.get_docstring(node) or ""
    plain = _Plain(source)
    body: list[ast.stmt] = []
    for statement in copy.deepcopy(node.body[1:] if doc else node.body):
        result = plain.visit(statement)
        body += result if isinstance(result, list) else [result] if result else []
    return Function(name, doc, tuple(arguments), body, source)


class _Plain(ast.NodeTransformer):
    """Rewrites statements for one lane, in place."""

    def __init__(self, source: Source) -> None:
        self.source = source
        #: Names of lanes, and of their number.
        self.lanes, self.counts = {"lane"}, {"LANES"}

    def visit_For(self, node: ast.For) -> Any:
        """Take statements out of a loop over lanes."""
        match node:
            case ast.For(target=ast.Name(id=index), iter=ast.Call(args=[ast.Name(id=count)])) if (
                count in self.counts
            ):
                self.lanes.add(index)
                return cast(ast.Module, self.generic_visit(ast.Module(node.body, []))).body
        return self.generic_visit(node)

    def visit_Assign(self, node: ast.Assign) -> Any:
        """Leave out the number of lanes and the array of a workspace, which are known."""
        (target,), value, kept = node.targets, node.value, []
        pairs = [(target, value)]
        if isinstance(target, ast.Tuple) and isinstance(value, ast.Tuple):
            pairs = list(zip(target.elts, value.elts, strict=True))
        for to, given in pairs:
            if isinstance(given, ast.Name) and given.id in self.counts:
                self.counts.add(ast.unparse(to))
            elif ast.unparse(given).startswith("carray("):
                continue
            else:
                kept.append((self.visit(to), self.visit(given)))
        assignments = [ast.copy_location(ast.Assign([to], given), node) for to, given in kept]
        names = {x.id for to, _ in kept[:-1] for x in ast.walk(to) if isinstance(x, ast.Name)}
        later = {x.id for _, y in kept[1:] for x in ast.walk(y) if isinstance(x, ast.Name)}
        assert len(kept) < 2 or not names & later - {WORKSPACE}, ast.unparse(node)
        return assignments

    def visit_Name(self, node: ast.Name) -> ast.expr:
        """Write 0 for a lane, and 1 for their number."""
        if node.id in self.lanes:
            return ast.Constant(0)
        return ast.Constant(1) if node.id in self.counts else node

    def visit_Compare(self, node: ast.Compare) -> ast.expr:
        """Compare lanes, of which there is one."""
        node = cast(ast.Compare, self.generic_visit(node))
        match node:
            case ast.Compare(ast.Constant(value=a), [ast.Eq()], [ast.Constant(value=b)]):
                return ast.Constant(a == b)
        return node

    def visit_IfExp(self, node: ast.IfExp) -> ast.expr:
        """Choose where a condition is known."""
        node = cast(ast.IfExp, self.generic_visit(node))
        if isinstance(node.test, ast.Constant):
            return node.body if node.test.value else node.orelse
        return node

    def visit_Subscript(self, node: ast.Subscript) -> ast.expr:
        """Leave out the index of a lane."""
        if ast.unparse(node) == ROWS:
            return ast.Name("at.ROWS", ast.Load())
        if isinstance(node.value, ast.Name):
            base, index = node.value.id, node.slice
            if base == "at":
                return ast.Name(f"at.{ast.unparse(index)}", ast.Load())
            if base not in self.source.constants and isinstance(index, ast.Tuple):
                node.slice = self.visit(index.elts[0])
                return node
            if base == WORKSPACE:  # a row of its own
                return ast.BinOp(node.value, ast.Add(), self.visit(index))
        node.slice = self.visit(node.slice)
        return node

    def visit_Call(self, node: ast.Call) -> ast.expr:
        """Leave out arguments that a function does not take any more."""
        name = getattr(node.func, "id", "")
        if name in self.source.functions:
            taken = [parameter.arg for parameter in self.source.functions[name].args.args]
            node.args = [x for x, to in zip(node.args, taken, strict=True) if to not in DROPPED]
        if name == "len":
            return ast.Constant(len(self.source.constants[ast.unparse(node.args[0])]))
        node.args = [self.visit(x) for x in node.args]
        return node
