"""Loops or calls whose turns can be done at once, as vectors."""

from __future__ import annotations

import ast
from collections.abc import Iterable, Iterator, Sequence

from symsimpson.targets.llvm.trees import Text, assigned, of_reals, weight

#: Names that a value comes from; that of the turn among them.
Origins = dict[str, frozenset[str]]
_WHOLE = "set as a whole"
_TURN, _OF_TURN = "the number of the turn", "a number that follows from it"
_MOVING = frozenset({_TURN, _OF_TURN})


def own_blocks(node: ast.For, name: str, text: Text) -> frozenset[str] | None:
    """Return the blocks of which each turn of a loop needs rows of its own.

    None if turns depend on each other, or branch.
    """
    accesses = _Accesses(text, node)
    fine = accesses.follow(node.body, {name: frozenset({_TURN})})
    # rows that one turn sets are no others'
    apart = not (accesses.first.keys() & accesses.set_along or accesses.written & accesses.along)
    set_first = all(accesses.first[block] == _WHOLE for block in accesses.written)
    return frozenset(accesses.written) if fine and apart and set_first else None


class _Accesses:
    """Uses of rows by statements, in their order.

    Of each block that all turns share ``first`` says what is done first with it: "read", "set", or
    "set as a whole"; those that are set are ``written``. Blocks with rows of each turn are
    ``along``, and ``set_along`` if turns set them.
    """

    def __init__(self, text: Text, loop: ast.For) -> None:
        self._text, self._depth = text, 0
        #: Variables of the loop that the turn has not set yet: the one before did.
        self._unset = set(assigned(loop.body))
        #: Variables that count from 0 to before a number.
        self._counts: dict[str, int] = {}
        self.first: dict[str, str] = {}
        self.written: set[str] = set()
        self.along: set[str] = set()
        self.set_along: set[str] = set()

    def follow(self, body: Iterable[ast.stmt], origins: Origins) -> bool:
        """Follow statements; returns whether all of them are of kinds that are known here."""
        return all(self._statement(statement, origins) for statement in body)

    def _statement(self, node: ast.stmt, origins: Origins) -> bool:
        match node:
            case ast.Expr(value=ast.Constant()):
                return True
            case ast.Expr(value=value):
                return self._read(value, origins)
            case ast.Assign(targets=[target], value=value):
                return self._read(value, origins) and self._set(
                    target, self._names(value, origins), origins
                )
            case ast.AugAssign(target=target, value=value):
                read = self._read(value, origins) and self._read(target, origins)
                return read and self._set(target, self._names(node, origins), origins)
            case ast.For(target=ast.Name(id=name), iter=source):
                origins[name] = self._names(source, origins)
                return not origins[name] & _MOVING and self._inner(node, name, origins)
            case ast.Return(value=ast.expr() as value):
                return self._read(value, origins)
        return False

    def _inner(self, node: ast.For, name: str, origins: Origins) -> bool:
        """Follow a loop in the loop, until it is known where all that it carries comes from."""
        match node.iter:
            case ast.Call(func=ast.Name(id="range"), args=[ast.Name(id=size)]):
                count = self._text.constants.get(size)
                self._counts[name] = count if isinstance(count, int) else 0
            case _:
                self._counts.pop(name, None)
        while True:
            before = dict(origins)
            if not self.follow(node.body, origins):
                return False
            for key in origins:
                origins[key] |= before.get(key, frozenset())
            if origins == before:
                return True

    def _called(self, function: ast.FunctionDef, given: list[frozenset[str]]) -> bool:
        self._depth += 1
        names = [parameter.arg for parameter in function.args.args]
        counts, self._counts = self._counts, {}
        fine = self.follow(function.body, dict(zip(names, given, strict=True)))
        self._depth, self._counts = self._depth - 1, counts
        return fine

    def _set(self, target: ast.expr, value: frozenset[str], origins: Origins) -> bool:
        match target:
            case ast.Name(id=name):
                origins[name] = value
                self._unset -= set() if self._depth else {name}
            case ast.Tuple(elts=parts):
                return all(self._set(part, value, origins) for part in parts)
            case ast.Subscript(value=ast.Name(id="W"), slice=ast.Tuple(elts=[row, _])):
                return self._access(row, origins, "set")
            case _:
                return False
        return True

    def _read(self, node: ast.AST, origins: Origins) -> bool:
        match node:
            case ast.Subscript(value=ast.Name(id="W"), slice=ast.Tuple(elts=[row, _])):
                return self._access(row, origins, "read")
            case ast.IfExp(test=test) if self._names(test, origins) & _MOVING:
                return False
            case ast.Call(func=ast.Name(id=called), args=arguments):
                if not all(self._read(argument, origins) for argument in arguments):
                    return False
                function = self._text.functions.get(called)
                given = [self._names(argument, origins) for argument in arguments]
                return function is None or self._called(function, given)
            case ast.Name(id=name) if not self._depth and name in self._unset:
                return False
        return all(self._read(child, origins) for child in ast.iter_child_nodes(node))

    def _access(self, row: ast.expr, origins: Origins, how: str) -> bool:
        names = self._names(row, origins)
        blocks = names & self._text.blocks.keys()
        if names & _MOVING:
            self.along |= blocks
            self.set_along |= blocks if how == "set" else set()
            return self._by_turn(row, origins)
        for block in blocks:
            whole = how == "set" and self._whole(row, block)
            self.first.setdefault(block, _WHOLE if whole else how)
        if how == "set":
            self.written |= blocks
        return bool(blocks)

    def _whole(self, row: ast.expr, block: str) -> bool:
        """Return whether a row goes through a whole block, in a loop of so many turns."""
        size = len(self._text.blocks[block])
        match row:
            case ast.BinOp(left=ast.Name(id=first), op=ast.Add(), right=ast.Name(id=name)):
                return first == block and size > 0 and self._counts.get(name) == size
            case ast.Name(id=first):
                return first == block and size == 1
        return False

    def _by_turn(self, row: ast.expr, origins: Origins) -> bool:
        """Return whether a row is BLOCK + turn, or BLOCK + k * STRIDE + turn."""
        match row:
            case ast.BinOp(left=first, op=ast.Add(), right=ast.Name(id=last)):
                match first:
                    case ast.BinOp(
                        left=ast.Name() as base,
                        op=ast.Add(),
                        right=ast.BinOp(
                            op=ast.Mult(), right=ast.Name(id="STRIDE" | "INPUT_STRIDE")
                        ),
                    ):
                        first = base
                sources = self._names(first, origins) if isinstance(first, ast.Name) else ()
                block = len(sources) == 1 and self._text.blocks.keys() >= sources
                return block and origins.get(last) == frozenset({_TURN})
        return False

    @staticmethod
    def _names(node: ast.AST, origins: Origins) -> frozenset[str]:
        if isinstance(node, ast.Name):
            return origins.get(node.id, frozenset({node.id}))
        names = [part.id for part in ast.walk(node) if isinstance(part, ast.Name)]
        sources = frozenset[str]().union(*(origins.get(name, frozenset({name})) for name in names))
        return sources - _MOVING | {_OF_TURN} if sources & _MOVING else sources


#: As many calls are one vector; functions of fewer operations are not worth it.
MOST, LEAST = 4, 20
#: What an expression is made of that may be computed earlier than where it stands.
_PLAIN = (
    *(ast.Name, ast.Constant, ast.BinOp, ast.UnaryOp),
    *(ast.operator, ast.unaryop, ast.expr_context),
)
#: What follows these statements may be left out.
LEAVING = (ast.Break, ast.Continue, ast.Return)
#: Statements at a place of a block; several are calls that are one vector.
Item = tuple[int, tuple[ast.stmt, ...]]


def in_order(body: Sequence[ast.stmt], text: Text) -> list[Item]:
    """Return the statements of a block in an order in which calls of one function stand together.

    What their arguments are made of is moved before them; all other statements keep their order.
    """
    return list(_Order(body, text).items())


class _Order:
    """The statements of a block, with what each of them reads and sets."""

    def __init__(self, body: Sequence[ast.stmt], text: Text) -> None:
        self.body, self.text = body, text
        self.calls = {k: name for k, node in enumerate(body) if (name := _called(node, text))}
        self.done: set[int] = set()
        self.leaves = [
            k
            for k, node in enumerate(body)
            if self.calls and any(isinstance(x, LEAVING) for x in ast.walk(node))
        ]
        if len(self.calls) < 2:
            return
        self.reads = [_read(node) for node in body]
        self.setters: dict[str, list[int]] = {}
        self.first_read: dict[str, int] = {}
        for k, node in enumerate(body):
            for name in assigned([node]):
                self.setters.setdefault(name, []).append(k)
            for name in self.reads[k]:
                self.first_read.setdefault(name, k)

    def items(self) -> Iterator[Item]:
        """Go through all statements."""
        for k, node in enumerate(self.body):
            if k in self.done:
                continue
            together = [k]
            for call in self._alike(k):
                before = self._before(call, k)
                if before is not None and len(together) < MOST:
                    yield from ((k, (self.body[n],)) for n in before)
                    self.done.update(before)
                    together.append(call)
            self.done.update(together)
            yield k, (node, *(self.body[n] for n in together[1:]))

    def _alike(self, k: int) -> list[int]:
        """Return later calls of the function that is called at a place, if one is.

        What stands behind a statement by which the block may be left stays there.
        """
        name = self.calls.get(k)
        end = next((n for n in self.leaves if n > k), len(self.body))
        return [n for n, other in self.calls.items() if k < n < end and other == name]

    def _before(self, call: int, k: int) -> list[int] | None:
        """Return the statements that a call must stand behind if it moves to place k, if it can."""
        if call in self.done:
            return None
        needed: set[int] = set()
        work = [call]
        while work:
            n = work.pop()
            if not self._may_move(n):
                return None
            for name in self.reads[n]:
                later = {m for m in self.setters.get(name, ()) if m >= k} - self.done - needed
                if later & self.calls.keys():
                    return None
                needed |= later
                work += later
        return sorted(needed)

    def _may_move(self, n: int) -> bool:
        """Return whether a statement gives names their only values, before anybody reads them."""
        names = assigned([self.body[n]])
        only = all(self.setters[x] == [n] and self.first_read.get(x, n + 1) > n for x in names)
        return only and _computes(self.body[n], self.text)


def _computes(node: ast.stmt, text: Text) -> bool:
    """Return whether a statement gives names the values of arithmetic, or of a function of it."""
    match node:
        case ast.Assign(targets=[target], value=value):
            names = all(isinstance(x, ast.Name) for x in getattr(target, "elts", [target]))
            return names and (_plain(value) or bool(_function(value, text)))
    return False


def _function(value: ast.expr, text: Text) -> str:
    """Return the function that is called with plain numbers and only computes, if one is."""
    match value:
        case ast.Call(func=ast.Name(id=name), args=[_, *_] as arguments, keywords=[]):
            function = text.functions.get(name)
            if function is not None and all(map(_plain, arguments)) and of_reals(function, text):
                return name
    return ""


def _called(node: ast.stmt, text: Text) -> str:
    """Return the function that a statement calls with plain numbers, if it is worth a vector."""
    name = _function(node.value, text) if isinstance(node, ast.Assign) else ""
    if not name or not _computes(node, text):
        return ""
    operations = sum(weight(statement, text) for statement in text.functions[name].body)
    return name if operations >= LEAST else ""


def _plain(value: ast.expr) -> bool:
    """Return whether an expression is arithmetic on names and numbers."""
    return all(isinstance(part, _PLAIN) for part in ast.walk(value))


def _read(node: ast.stmt) -> frozenset[str]:
    """Return the names that a statement reads, or changes."""
    names = (part for part in ast.walk(node) if isinstance(part, ast.Name))
    changed = assigned([node]) if isinstance(node, ast.AugAssign) else frozenset()
    return changed.union(part.id for part in names if isinstance(part.ctx, ast.Load))
