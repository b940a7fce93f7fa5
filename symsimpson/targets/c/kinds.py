"""Functions of a module or of the driver, prepared for C: with one lane and known C types.

The texts are the same as for the compiled kernels. In C there is only one lane, so lane indices,
loops over lanes and lane arguments are removed. An entry of the driver's layout, ``at[NAME]``,
becomes a constant.
"""

from __future__ import annotations

import ast
import copy
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import groupby
from typing import Any, NoReturn, cast

import numpy as np

from symsimpson.errors import reject

#: Arguments that C functions do not have.
DROPPED = ("lane", "at")
#: The name of the workspace, and the expression for its number of rows.
WORKSPACE, ROWS = "W", "W.shape[0]"


@dataclass(frozen=True)
class Source:
    """The functions of a module or of the driver, and the constants that they name."""

    functions: Mapping[str, ast.FunctionDef]
    constants: Mapping[str, Any]  #: Numbers, tuples or arrays.
    driver_layout: Mapping[str, int]  #: Values of ``at[NAME]``.
    lines: list[str]  #: Lines of the text, which contain its comments.


@dataclass(frozen=True)
class Function:
    """A function of a text, rewritten for one lane."""

    name: str
    doc: str
    arguments: tuple[str, ...]
    body: list[ast.stmt]
    source: Source


class Functions(Mapping[str, Function]):
    """The functions of several sources by name; each is rewritten at its first access."""

    def __init__(self, sources: Sequence[Source]) -> None:
        self._source = {name: source for source in sources for name in source.functions}
        self._read: dict[str, Function] = {}

    def __getitem__(self, name: str) -> Function:
        if name not in self._read:
            self._read[name] = remove_lanes(name, self._source[name])
        return self._read[name]

    def __contains__(self, name: object) -> bool:
        return name in self._source

    def __iter__(self) -> Iterator[str]:
        return iter(self._source)

    def __len__(self) -> int:
        return len(self._source)


def remove_lanes(name: str, source: Source) -> Function:
    """Rewrite a function of a source for one lane."""
    node = source.functions[name]
    arguments = [argument.arg for argument in node.args.args if argument.arg not in DROPPED]
    if "workspace" in arguments:  # a kernel, which converts this pointer to an array
        arguments[arguments.index("workspace")] = WORKSPACE
    doc = ast.get_docstring(node) or ""
    plain = _LaneRemover(source)
    body: list[ast.stmt] = []
    for statement in copy.deepcopy(node.body[1:] if doc else node.body):
        result = plain.visit(statement)
        body += result if isinstance(result, list) else [result] if result else []
    return Function(name, doc, tuple(arguments), body, source)


class _LaneRemover(ast.NodeTransformer):
    """Rewrites statements for one lane, in place."""

    def __init__(self, source: Source) -> None:
        self.source = source
        #: Names of lane indices, and of the number of lanes.
        self.lanes, self.counts = {"lane"}, {"LANES"}

    def visit_For(self, node: ast.For) -> Any:
        """Replace a loop over lanes by its body."""
        match node:
            case ast.For(target=ast.Name(id=index), iter=ast.Call(args=[ast.Name(id=count)])) if (
                count in self.counts
            ):
                self.lanes.add(index)
                return cast(ast.Module, self.generic_visit(ast.Module(node.body, []))).body
        return self.generic_visit(node)

    def visit_Assign(self, node: ast.Assign) -> Any:
        """Remove assignments of the number of lanes and of the workspace array."""
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
        """Replace a lane index by 0, and the number of lanes by 1."""
        if node.id in self.lanes:
            return ast.Constant(0)
        return ast.Constant(1) if node.id in self.counts else node

    def visit_Compare(self, node: ast.Compare) -> ast.expr:
        """Evaluate a comparison of two constants."""
        node = cast(ast.Compare, self.generic_visit(node))
        match node:
            case ast.Compare(ast.Constant(value=a), [ast.Eq()], [ast.Constant(value=b)]):
                return ast.Constant(a == b)
        return node

    def visit_IfExp(self, node: ast.IfExp) -> ast.expr:
        """Evaluate a conditional expression whose condition is constant."""
        node = cast(ast.IfExp, self.generic_visit(node))
        if isinstance(node.test, ast.Constant):
            return node.body if node.test.value else node.orelse
        return node

    def visit_Subscript(self, node: ast.Subscript) -> ast.expr:
        """Remove the lane index of a row, and name the constants of the layout."""
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
        """Remove the arguments that C functions do not have."""
        name = getattr(node.func, "id", "")
        if name in self.source.functions:
            taken = [parameter.arg for parameter in self.source.functions[name].args.args]
            node.args = [x for x, to in zip(node.args, taken, strict=True) if to not in DROPPED]
        if name == "len":
            return ast.Constant(len(self.source.constants[ast.unparse(node.args[0])]))
        node.args = [self.visit(x) for x in node.args]
        return node


#: C types of integers and conditions, real numbers, rows, kernels, and sets of kernels.
INT, REAL, POINTER, KERNEL, SET = "int", "double", "double *", "kernel *", "const kernels *"
#: Functions whose result is an integer if all arguments are integers.
INTEGER_PRESERVING = ("min", "max", "abs")


@dataclass
class Signature:
    """The C types of the arguments and of the result of a function.

    ``several`` is the number of results of a function that returns a tuple.
    """

    arguments: list[str]
    returned: str | None = None
    several: int = 0


@dataclass
class Kinds:
    """The C types ("kinds") of the local names of functions, inferred by following calls."""

    functions: Mapping[str, Function]
    #: Signatures by function; ``names[function][name]`` is the kind of a local name.
    signatures: dict[str, Signature] = field(default_factory=dict)
    names: dict[str, dict[str, str]] = field(default_factory=dict)

    def follow(self, name: str, given: list[str]) -> Signature:
        """Infer the kinds in a function from a call with arguments of these kinds."""
        function = self.functions[name]
        signature = self.signatures.get(name)
        if signature is not None:
            joined = [_common_kind(a, b) for a, b in zip(signature.arguments, given, strict=True)]
            if joined == signature.arguments:
                return signature
            given = joined
        self.signatures[name] = Signature(given)
        local = dict(zip(function.arguments, given, strict=True))
        self.names[name] = local
        while True:
            before = dict(local)
            for statement in function.body:
                self._infer_statement(statement, name, local)
            if local == before:
                return self.signatures[name]

    def _infer_statement(self, node: ast.stmt, name: str, local: dict[str, str]) -> None:
        match node:
            case ast.For(target=ast.Name(id=index), iter=over, body=body):
                local[index] = INT
                for argument in getattr(over, "args", ()):  # of a range; a table has none
                    self.of(argument, name)
                for statement in body:
                    self._infer_statement(statement, name, local)
            case ast.If(test=test, body=body, orelse=orelse):
                self.of(test, name)
                for statement in [*body, *orelse]:
                    self._infer_statement(statement, name, local)
            case ast.Assign(targets=[ast.Name(id=target)], value=value):
                kind = self.of(value, name)
                local[target] = _common_kind(local.get(target, kind), kind)
            case ast.Assign(targets=[ast.Tuple(elts=targets)], value=value):
                self.of(value, name)
                local.update({ast.unparse(element): REAL for element in targets})
            case ast.AugAssign(target=ast.Name(id=target), value=value):
                local[target] = _common_kind(local[target], self.of(value, name))
            case (
                ast.Assign(targets=[place], value=value) | ast.AugAssign(target=place, value=value)
            ):
                self.of(place, name)
                self.of(value, name)
            case ast.Return(value=ast.Tuple(elts=values)):
                self.signatures[name].several = len(values)
            case ast.Return(value=ast.expr() as value):
                before, kind = self.signatures[name].returned, self.of(value, name)
                self.signatures[name].returned = _common_kind(before or kind, kind)
            case ast.Expr(value=value):
                self.of(value, name)

    def of(self, node: ast.expr, name: str) -> str:
        """Return the kind of an expression in the function ``name``."""
        function = self.functions[name]
        match node:
            case ast.Constant(value=value):
                return REAL if isinstance(value, float) else INT
            case ast.Name(id=identifier) if identifier in self.names[name]:
                return self.names[name][identifier]
            case ast.Name(id=identifier):
                value = constant_of(identifier, function)
                return REAL if isinstance(value, float) else INT
            case ast.Subscript(value=ast.Name(id="kernels"), slice=ast.Name(id=what)):
                return INT if what == "MODE" else KERNEL
            case ast.Subscript(value=value, slice=index):
                self.of(index, name)
                base = _base(value)
                if base in self.names[name]:
                    return REAL
                table = np.asarray(constant_of(base, function))
                return INT if table.dtype.kind == "i" else REAL
            case ast.BinOp(left=left, right=right, op=op):
                kinds = self.of(left, name), self.of(right, name)
                return REAL if isinstance(op, ast.Div) else _common_kind(*kinds)
            case ast.UnaryOp(operand=operand, op=op):
                kind = self.of(operand, name)
                return INT if isinstance(op, ast.Not) else kind
            case ast.IfExp(test=test, body=body, orelse=orelse):
                self.of(test, name)
                return _common_kind(self.of(body, name), self.of(orelse, name))
            case ast.Compare(left=left, comparators=others):
                for operand in (left, *others):
                    self.of(operand, name)
                return INT
            case ast.BoolOp(values=values) | ast.Tuple(elts=values):
                for element in values:
                    self.of(element, name)
                return INT
            case ast.Attribute(attr="inf"):
                return REAL
            case ast.Call():
                return self._call_kind(node, name)
        reject_line(node, name)

    def _call_kind(self, node: ast.Call, name: str) -> str:
        given = [self.of(argument, name) for argument in node.args]
        called = ast.unparse(node.func)
        if called in self.functions and called != "sincos":
            return self.follow(called, given).returned or "void"
        if called in ("np.empty", "np.zeros"):
            return POINTER
        if called in INTEGER_PRESERVING:
            return INT if set(given) == {INT} else REAL
        return INT if called == "int" else REAL


def reject_line(node: ast.AST, name: str) -> NoReturn:
    """Raise InputError for a line of the function ``name`` that C cannot express."""
    reject("a line has no counterpart in C.", where=name, why=f"The line is {ast.unparse(node)}.")


def constant_of(name: str, function: Function) -> Any:
    """Return the value of a constant that a function names."""
    source = function.source
    if name.startswith("at."):
        return source.driver_layout[name[3:]]
    return source.constants[name]


def _base(node: ast.expr) -> str:
    """Return the name of an array or a table without its indices."""
    while isinstance(node, ast.Subscript):
        node = node.value
    return ast.unparse(node)


def _common_kind(a: str, b: str) -> str:
    return REAL if {a, b} == {INT, REAL} else a


def fix_array_lengths(body: list[ast.stmt]) -> list[ast.stmt]:
    """Give arrays constant lengths: replace names that are assigned once by their values."""
    values: dict[str, list[ast.expr]] = {}
    arrays = []
    for x in (x for statement in body for x in ast.walk(statement)):
        match x:
            case ast.Assign(targets=[ast.Name(id=name)], value=value):
                values.setdefault(name, []).append(value)
                if ast.unparse(getattr(value, "func", value)) in ("np.empty", "np.zeros"):
                    arrays.append(value)

    def known(node: ast.expr) -> ast.expr:
        match node:
            case ast.Name(id=name) if len(values.get(name, ())) == 1:
                return known(values[name][0])
            case ast.BinOp(left=left, op=op, right=right):
                return ast.BinOp(known(left), op, known(right))
        return node

    for call in arrays:
        (shape,) = call.args  # type: ignore[attr-defined]
        call.args = [known(getattr(shape, "elts", [shape])[0])]  # type: ignore[attr-defined]
    return body


def remove_unread(body: list[ast.stmt]) -> list[ast.stmt]:
    """Remove assignments of values that nothing reads, repeatedly."""
    while True:
        read = {
            x.id
            for statement in body
            for x in ast.walk(statement)
            if isinstance(x, ast.Name) and isinstance(x.ctx, ast.Load)
        }
        pruned = _UnreadRemover(read)
        body = [left for statement in body if (left := pruned.visit(statement)) is not None]
        if not pruned.found:
            return body


class _UnreadRemover(ast.NodeTransformer):
    """Removes assignments to names that are not in ``read``."""

    def __init__(self, read: set[str]) -> None:
        self.read, self.found = read, False

    def visit_Assign(self, node: ast.Assign) -> ast.stmt | None:
        (target,) = node.targets
        if isinstance(target, ast.Name) and target.id not in self.read:
            self.found = True
            return None
        return node


#: A use of a name: the enclosing blocks from the outermost on, the statement, and True for an
#: assignment.
_Place = tuple[tuple[int, ...], int, bool]


class Scopes:
    """The places of declarations: the first assignment of a name, if all its uses are in scope."""

    def __init__(self, body: list[ast.stmt], arguments: set[str]) -> None:
        self._places: dict[str, list[_Place]] = {}
        self._visit(body, (), frozenset(arguments))
        #: For each name and the statement that declares it, True if the value is constant.
        self.begins: dict[tuple[str, int], bool] = {}
        self.stored = {k for k, x in self._places.items() if any(gets for *_, gets in x)}
        #: Names and statements that assign a value which nothing reads.
        self.unread: set[tuple[str, int]] = set()
        #: Names to declare at the beginning of the function.
        self.ahead = {name for name, places in self._places.items() if self._declare(name, places)}

    def _declare(self, name: str, places: list[_Place]) -> bool:
        """Find the declarations of a name; return True if it needs one at the beginning."""
        declarations = _find_declarations(places, 0)
        if declarations is not None:
            for statement_id, fixed, read in declarations:
                if read:
                    self.begins[name, statement_id] = fixed
                else:
                    self.unread.add((name, statement_id))
        return declarations is None

    def _visit(self, body: list[ast.stmt], path: tuple[int, ...], bound: frozenset[str]) -> None:
        for statement in body:
            match statement:
                case ast.For(target=ast.Name(id=index), iter=bounds, body=inner):
                    self._read(bounds, path, statement, bound)
                    self._visit(inner, (*path, id(statement)), bound | {index})
                case ast.If(test=test, body=inner, orelse=orelse):
                    self._read(test, path, statement, bound)
                    self._visit(inner, (*path, id(statement)), bound)
                    self._visit(orelse, (*path, -id(statement)), bound)
                case ast.Assign(targets=[target], value=value):
                    self._read(value, path, statement, bound)
                    for to in target.elts if isinstance(target, ast.Tuple) else [target]:
                        self._store(to, path, statement, bound)
                case ast.AugAssign(target=target, value=value):
                    self._read(value, path, statement, bound)
                    self._read(target, path, statement, bound)
                    self._store(target, path, statement, bound)
                case _:
                    self._read(statement, path, statement, bound)

    def _read(
        self, node: ast.AST, path: tuple[int, ...], at: ast.stmt, bound: frozenset[str]
    ) -> None:
        for x in ast.walk(node):
            if isinstance(x, ast.Name) and x.id not in bound:
                self._places.setdefault(x.id, []).append((path, id(at), False))

    def _store(
        self, target: ast.expr, path: tuple[int, ...], at: ast.stmt, bound: frozenset[str]
    ) -> None:
        if not isinstance(target, ast.Name):
            self._read(target, path, at, bound)
        elif target.id not in bound:
            self._places.setdefault(target.id, []).append((path, id(at), True))


def _find_declarations(places: list[_Place], depth: int) -> list[tuple[int, bool, bool]] | None:
    """Return the statements that declare a name; None if its value may come from another block.

    Each entry is the statement, True if the value is constant, and True if it is read later.
    """
    while all(len(x) > depth and x[depth] == places[0][0][depth] for x, _, _ in places):
        depth += 1
    path, first, stores = places[0]
    if len(path) == depth:
        values = sum(gets for *_, gets in places)
        return [(first, values == 1, values < len(places))] if stores else None
    if any(len(x) == depth for x, _, _ in places):
        return None
    declarations = []
    for _, some in groupby(places, key=lambda x: x[0][depth]):
        inner = _find_declarations(list(some), depth + 1)
        if inner is None:
            return None
        declarations += inner
    return declarations
