"""Analysis of loops and calls that can become vector instructions."""

from __future__ import annotations

import ast
from collections.abc import Iterable, Iterator, Sequence

from symsimpson.targets.llvm.trees import Text, assigned, is_real_arithmetic, weight

#: For each variable, the names that its value depends on, including the number of the turn.
Origins = dict[str, frozenset[str]]
_WHOLE = "set as a whole"
_TURN, _OF_TURN = "the number of the turn", "a number that follows from it"
_MOVING = frozenset({_TURN, _OF_TURN})


def private_blocks(node: ast.For, name: str, text: Text) -> frozenset[str] | None:
    """Return the blocks of which each turn of a loop needs private rows.

    The result is None if turns depend on each other, or branch.
    """
    accesses = _RowAccesses(text, node)
    fine = accesses.follow(node.body, {name: frozenset({_TURN})})
    # no turn uses rows that another turn sets
    apart = not (accesses.first.keys() & accesses.set_along or accesses.written & accesses.along)
    set_first = all(accesses.first[block] == _WHOLE for block in accesses.written)
    return frozenset(accesses.written) if fine and apart and set_first else None


class _RowAccesses:
    """The reads and writes of rows by the statements of a loop, in their order.

    ``first`` has the first access to each block that all turns share: "read", "set" or "set as a
    whole". ``written`` has the shared blocks that turns set. ``along`` has the blocks with separate
    rows for each turn, and ``set_along`` those of them that turns set.
    """

    def __init__(self, text: Text, loop: ast.For) -> None:
        self._text, self._depth = text, 0
        #: Variables of the loop that the turn has not set yet, so that they have earlier values.
        self._unset = set(assigned(loop.body))
        #: Loop variables that count from 0, with their numbers of turns.
        self._counts: dict[str, int] = {}
        self.first: dict[str, str] = {}
        self.written: set[str] = set()
        self.along: set[str] = set()
        self.set_along: set[str] = set()

    def follow(self, body: Iterable[ast.stmt], origins: Origins) -> bool:
        """Follow statements; return False if one of them is unsupported."""
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
                return not origins[name] & _MOVING and self._follow_loop(node, name, origins)
            case ast.Return(value=ast.expr() as value):
                return self._read(value, origins)
        return False

    def _follow_loop(self, node: ast.For, name: str, origins: Origins) -> bool:
        """Follow an inner loop until the origins of its variables no longer change."""
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

    def _follow_call(self, function: ast.FunctionDef, given: list[frozenset[str]]) -> bool:
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
                return function is None or self._follow_call(function, given)
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
        """Return True if an index runs through a whole block in the present loop."""
        size = len(self._text.blocks[block])
        match row:
            case ast.BinOp(left=ast.Name(id=first), op=ast.Add(), right=ast.Name(id=name)):
                return first == block and size > 0 and self._counts.get(name) == size
            case ast.Name(id=first):
                return first == block and size == 1
        return False

    def _by_turn(self, row: ast.expr, origins: Origins) -> bool:
        """Return True if an index is BLOCK + turn, or BLOCK + k * STRIDE + turn."""
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


#: The largest number of calls in one vector, and the fewest operations of such a function.
MOST, LEAST = 4, 20
#: Node types of expressions that may be evaluated earlier.
_PLAIN = (
    *(ast.Name, ast.Constant, ast.BinOp, ast.UnaryOp),
    *(ast.operator, ast.unaryop, ast.expr_context),
)
#: Statements that leave a block.
LEAVING = (ast.Break, ast.Continue, ast.Return)
#: The place of statements in a block, and the statements; several are calls for one vector.
Item = tuple[int, tuple[ast.stmt, ...]]


def order_statements(body: Sequence[ast.stmt], text: Text) -> list[Item]:
    """Order the statements of a block so that calls of one function are adjacent.

    The statements that compute the arguments of a moved call move before it. All other statements
    keep their order.
    """
    return list(_StatementOrder(body, text).items())


class _StatementOrder:
    """The statements of a block, with the names that each of them reads and sets."""

    def __init__(self, body: Sequence[ast.stmt], text: Text) -> None:
        self.body, self.text = body, text
        self.calls = {
            k: name for k, node in enumerate(body) if (name := _vector_function(node, text))
        }
        self.done: set[int] = set()
        self.leaves = [
            k
            for k, node in enumerate(body)
            if self.calls and any(isinstance(x, LEAVING) for x in ast.walk(node))
        ]
        if len(self.calls) < 2:
            return
        self.reads = [_names_read(node) for node in body]
        self.setters: dict[str, list[int]] = {}
        self.first_read: dict[str, int] = {}
        for k, node in enumerate(body):
            for name in assigned([node]):
                self.setters.setdefault(name, []).append(k)
            for name in self.reads[k]:
                self.first_read.setdefault(name, k)

    def items(self) -> Iterator[Item]:
        """Iterate over all statements in their new order."""
        for k, node in enumerate(self.body):
            if k in self.done:
                continue
            together = [k]
            for call in self._similar_calls(k):
                before = self._prerequisites(call, k)
                if before is not None and len(together) < MOST:
                    yield from ((k, (self.body[n],)) for n in before)
                    self.done.update(before)
                    together.append(call)
            self.done.update(together)
            yield k, (node, *(self.body[n] for n in together[1:]))

    def _similar_calls(self, k: int) -> list[int]:
        """Return the later calls of the function that statement k calls.

        Calls after a statement that may leave the block do not count.
        """
        name = self.calls.get(k)
        end = next((n for n in self.leaves if n > k), len(self.body))
        return [n for n, other in self.calls.items() if k < n < end and other == name]

    def _prerequisites(self, call: int, k: int) -> list[int] | None:
        """Return the statements to move with a call to place k; None if it cannot move."""
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
        """Return True if a statement is the only assignment of its names, before all reads."""
        names = assigned([self.body[n]])
        only = all(self.setters[x] == [n] and self.first_read.get(x, n + 1) > n for x in names)
        return only and _is_computation(self.body[n], self.text)


def _is_computation(node: ast.stmt, text: Text) -> bool:
    """Return True if a statement assigns arithmetic, or a function of arithmetic, to names."""
    match node:
        case ast.Assign(targets=[target], value=value):
            names = all(isinstance(x, ast.Name) for x in getattr(target, "elts", [target]))
            return names and (_is_arithmetic(value) or bool(_called_function(value, text)))
    return False


def _called_function(value: ast.expr, text: Text) -> str:
    """Return the name of a real function that is called with arithmetic arguments, else ""."""
    match value:
        case ast.Call(func=ast.Name(id=name), args=[_, *_] as arguments, keywords=[]):
            function = text.functions.get(name)
            if (
                function is not None
                and all(map(_is_arithmetic, arguments))
                and is_real_arithmetic(function, text)
            ):
                return name
    return ""


def _vector_function(node: ast.stmt, text: Text) -> str:
    """Return the name of a function that a statement calls, if a vector is worthwhile, else ""."""
    name = _called_function(node.value, text) if isinstance(node, ast.Assign) else ""
    if not name or not _is_computation(node, text):
        return ""
    operations = sum(weight(statement, text) for statement in text.functions[name].body)
    return name if operations >= LEAST else ""


def _is_arithmetic(value: ast.expr) -> bool:
    """Return True if an expression is arithmetic of names and numbers."""
    return all(isinstance(part, _PLAIN) for part in ast.walk(value))


def _names_read(node: ast.stmt) -> frozenset[str]:
    """Return the names that a statement reads or changes."""
    names = (part for part in ast.walk(node) if isinstance(part, ast.Name))
    changed = assigned([node]) if isinstance(node, ast.AugAssign) else frozenset()
    return changed.union(part.id for part in names if isinstance(part.ctx, ast.Load))
