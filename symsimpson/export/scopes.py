"""Names of a function: which are read, how long its arrays are, and where each is declared."""

from __future__ import annotations

import ast
from itertools import groupby


def with_lengths(body: list[ast.stmt]) -> list[ast.stmt]:
    """Let arrays have lengths that the compiler knows: names that have one value are that value."""
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


def used(body: list[ast.stmt]) -> list[ast.stmt]:
    """Leave out values that nothing reads, until none is left."""
    while True:
        read = {
            x.id
            for statement in body
            for x in ast.walk(statement)
            if isinstance(x, ast.Name) and isinstance(x.ctx, ast.Load)
        }
        pruned = _Unread(read)
        body = [left for statement in body if (left := pruned.visit(statement)) is not None]
        if not pruned.found:
            return body


class _Unread(ast.NodeTransformer):
    """Takes away assignments of values to names that are not read."""

    def __init__(self, read: set[str]) -> None:
        self.read, self.found = read, False

    def visit_Assign(self, node: ast.Assign) -> ast.stmt | None:
        (target,) = node.targets
        if isinstance(target, ast.Name) and target.id not in self.read:
            self.found = True
            return None
        return node


#: A place of a name: the blocks around it, from the outermost on, the statement, and whether it
#: gets a value there.
_Place = tuple[tuple[int, ...], int, bool]


class Scopes:
    """Where names are declared: as they first get a value, if all that use them stand there."""

    def __init__(self, body: list[ast.stmt], arguments: set[str]) -> None:
        self._places: dict[str, list[_Place]] = {}
        self._visit(body, (), frozenset(arguments))
        #: Of each name and statement that declares it, whether it has no other value later.
        self.begins: dict[tuple[str, int], bool] = {}
        self.stored = {k for k, x in self._places.items() if any(gets for *_, gets in x)}
        #: Names and statements that give them a value which nothing reads.
        self.unread: set[tuple[str, int]] = set()
        #: Names that must be known before.
        self.ahead = {name for name, places in self._places.items() if self._declared(name, places)}

    def _declared(self, name: str, places: list[_Place]) -> bool:
        """Declare a name where it first gets a value; return whether it must be known before."""
        declarations = _beginnings(places, 0)
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


def _beginnings(places: list[_Place], depth: int) -> list[tuple[int, bool, bool]] | None:
    """Return the statements that declare a name, whether it has one value and is read behind them.

    None where a name that is read may have got its value in another block.
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
        inner = _beginnings(list(some), depth + 1)
        if inner is None:
            return None
        declarations += inner
    return declarations
