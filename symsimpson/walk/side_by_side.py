"""Calls of one function that need nothing of each other: they are one vector.

The sines and cosines of all angles at the nodes are most of a step of one trajectory, and what the
angles are made of can be computed before the first of them.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator, Sequence

from symsimpson.walk.text import Text
from symsimpson.walk.trees import assigned, of_reals, weight

__all__ = ["in_order"]

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
