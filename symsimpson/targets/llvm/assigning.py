"""Assignments and branches of a text; where lanes of a vector take different ways, by masks.

What a branch assigns is then computed for all lanes, and kept in those that take it. Scratch needs
no such choice where the branch is all that is left of a kernel: nothing asks for it later.
"""

from __future__ import annotations

import ast
from abc import abstractmethod
from collections.abc import Callable, Iterable, Sequence
from itertools import chain
from typing import Any

from llvmlite import ir

from symsimpson.targets.llvm.control_flow import Slot
from symsimpson.targets.llvm.expressions import Env, Expressions, Product
from symsimpson.targets.llvm.memory import Array
from symsimpson.targets.llvm.trees import assigned
from symsimpson.targets.llvm.values import DOUBLE, Refused, known
from symsimpson.targets.llvm.vectors import Item, in_order


class Assigning(Expressions):
    """Walks assignments and branches."""

    #: The branch that is all that is left of a kernel; whether that, and none in it, is walked.
    _rest: list[ast.stmt] | None = None
    _all_left = False

    @abstractmethod
    def _last(self, body: Sequence[ast.stmt], env: Env) -> bool:
        """Walk the last statements of the present one: nothing of it is left behind them."""

    def _changed(self, before: Any, op: ast.operator, value: ast.expr, env: Env) -> Any:
        product = self._factors(value, env) if isinstance(op, (ast.Add, ast.Sub)) else None
        if product is None:
            return self._binary(op, before, self._value(value, env))
        return self._with_product(before, product, minus=isinstance(op, ast.Sub))

    def _leave(self, result: Any) -> bool:
        """Leave a function, from a branch or a loop by way of a block and variables."""
        frame, values = self._frames[-1], self._values
        if frame.mask is not self._mask:
            raise Refused("a function that some of the lanes leave")
        if not frame.depth and frame.exit is None:
            frame.result = result
            return True
        if result is not None:
            results = result if isinstance(result, list) else [result]
            if frame.slots is None:
                frame.slots = [values.slot(part, self._width) for part in results]
                frame.result = frame.slots if isinstance(result, list) else frame.slots[0]
            for slot, value in zip(frame.slots, results, strict=True):
                values.write(slot, value)
        frame.exit = frame.exit or values.builder.append_basic_block("left")
        values.builder.branch(frame.exit)
        return True

    def _assign(self, target: ast.expr, value: Any, env: Env) -> None:
        if not isinstance(target, ast.Tuple):
            self._put(target, self._places(target, env), value, env)
            return
        for part, item in zip(target.elts, value, strict=True):
            self._assign(part, item, env)

    def _at(self, target: Any, place: Any, env: Env) -> Any:
        return self._named(target.id, env) if place is None else self._read(place)

    def _in_order(self, body: Sequence[ast.stmt]) -> Iterable[Item]:
        """Go over statements; single numbers have an order in which calls stand together."""
        if self._width or not body:
            return ((k, (statement,)) for k, statement in enumerate(body))
        if body[0] not in self._orders:
            self._orders[body[0]] = in_order(body, self._text)
        return self._orders[body[0]]

    def _together(self, statements: Sequence[ast.stmt], env: Env) -> bool:
        """Walk calls of a function with single numbers as a call with vectors."""
        values, lanes = self._values, len(statements)
        pairs = [(x.targets[0], x.value) for x in statements if isinstance(x, ast.Assign)]
        calls = [call for _, call in pairs if isinstance(call, ast.Call)]
        given = [[self._value(x, env) for x in call.args] for call in calls]
        name = ast.unparse(calls[0].func)
        reals = all(getattr(x, "type", None) == DOUBLE for x in chain(*given))
        if name in self._apart or not reals:
            results = [self._called(name, arguments) for arguments in given]
        else:
            given += given[:1] * (lanes % 2)  # no vector has an odd number of lanes
            columns = zip(*given, strict=True)
            vectors = [values.joined([*column]) for column in columns]
            self._width = len(given)
            result = self._inside(self._text.functions[name], vectors)
            self._width = 0
            parts = result if isinstance(result, list) else [result]
            rows = [
                [x if known(x) else values.element(x, lane) for x in parts] for lane in range(lanes)
            ]
            results = rows if isinstance(result, list) else [x for (x,) in rows]
        for (target, _), value in zip(pairs, results, strict=True):
            self._assign(target, value, env)
        return False

    def _put(self, target: Any, place: Any, value: Any, env: Env) -> None:
        if place is not None:
            if not isinstance(place[0], Array):
                raise Refused("an assignment into something else")
            if self._mask is not None and not (self._all_left and self._in_scratch(target, env)):
                value = self._values.choose(self._mask, value, self._read(place))
            self._values.store(place[0], place[1], value, self._width)
        elif isinstance(slot := env.get(target.id), Slot):
            if self._mask is not slot.mask:
                value = self._values.choose(self._mask, value, self._values.read(slot))
            self._values.write(slot, value)
        else:
            env[target.id] = value

    def _if(self, truth: Any, body: Any, other: Any, env: Env) -> bool:
        if known(truth):
            return self._last(body if truth else other, env)
        self._let_change(assigned([*body, *other]), env)
        names = set(env)
        frame = self._frames[-1]

        def way(statements: Any) -> Callable[[], bool]:
            def walk() -> bool:
                return self._last(statements, dict(env))

            return walk

        frame.depth += 1
        if isinstance(truth.type, ir.VectorType):
            left = False
            around, self._all_left = self._all_left, body is self._rest
            self._by_masks(truth, way(body), way(other) if other else None)
            self._all_left = around
        else:
            left = self._values.branch(truth, way(body), way(other))
        frame.depth -= 1
        for name in set(env) - names:
            del env[name]
        return left

    def _by_masks(
        self, truth: Any, yes: Callable[[], bool], other: Callable[[], bool] | None
    ) -> None:
        """Walk both ways, each unless no lane takes it."""
        around, values = self._mask, self._values
        for mask, way in ((truth, yes), (values.no(truth), other)):
            if way is not None:
                self._mask = mask if around is None else values.both(around, mask)
                values.branch(values.any(self._mask), way, lambda: False)
                self._mask = around

    def _in_scratch(self, target: Any, env: Env) -> bool:
        """Return whether a row stands in a block in which no kernel leaves anything."""
        match target:
            case ast.Subscript(value=ast.Name(id="W"), slice=ast.Tuple(elts=[row, _])):
                while isinstance(row, ast.BinOp) and isinstance(row.op, ast.Add):
                    row = row.left
                first = env.get(row.id, row.id) if isinstance(row, ast.Name) else None
                scratch = self._text.scratch
                return first in scratch or any(first in rows for rows in scratch.values())
        return False

    def _let_change(self, names: frozenset[str], env: Env) -> None:
        """Make variables of what has a value and is going to change."""
        for name in sorted(names & set(env)):
            if isinstance(env[name], Product):
                env[name] = self._named(name, env)
            if not isinstance(env[name], Slot):
                try:
                    env[name] = self._values.slot(env[name], self._width, self._mask)
                except Refused:
                    del env[name]  # set anew before it is read, or it is missed there
