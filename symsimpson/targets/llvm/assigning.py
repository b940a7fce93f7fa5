"""Assignments and branches of a text, with masks for lanes that take different branches.

If lanes take different branches, all lanes compute the assigned values, and the active lanes store
them. Scratch needs no mask in a branch that ends a kernel, because nothing reads it later.
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
from symsimpson.targets.llvm.values import DOUBLE, UnsupportedConstruct, is_known
from symsimpson.targets.llvm.vectors import Item, order_statements


class Assignments(Expressions):
    """Emits assignments and branches."""

    #: The branch that ends a kernel, and whether the walker is directly in it.
    _rest: list[ast.stmt] | None = None
    _is_final_branch = False

    @abstractmethod
    def _walk_final(self, body: Sequence[ast.stmt], env: Env) -> bool:
        """Emit statements that end the present one, so that it uses no scratch after them."""

    def _augmented_value(self, before: Any, op: ast.operator, value: ast.expr, env: Env) -> Any:
        product = self._factors(value, env) if isinstance(op, (ast.Add, ast.Sub)) else None
        if product is None:
            return self._binary(op, before, self._value(value, env))
        return self._with_product(before, product, minus=isinstance(op, ast.Sub))

    def _leave(self, result: Any) -> bool:
        """Emit a return; in a branch or a loop, it stores the result and jumps to the exit."""
        frame, values = self._frames[-1], self._values
        if frame.mask is not self._mask:
            raise UnsupportedConstruct("a function that some of the lanes leave")
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
            self._store_target(target, self._places(target, env), value, env)
            return
        for part, item in zip(target.elts, value, strict=True):
            self._assign(part, item, env)

    def _read_target(self, target: Any, place: Any, env: Env) -> Any:
        return self._look_up(target.id, env) if place is None else self._read(place)

    def _ordered_statements(self, body: Sequence[ast.stmt]) -> Iterable[Item]:
        """Return the statements of a block; without vectors, similar calls are adjacent."""
        if self._width or not body:
            return ((k, (statement,)) for k, statement in enumerate(body))
        if body[0] not in self._orders:
            self._orders[body[0]] = order_statements(body, self._text)
        return self._orders[body[0]]

    def _vectorise_calls(self, statements: Sequence[ast.stmt], env: Env) -> bool:
        """Emit several calls of one function with scalars as one call with vectors."""
        values, lanes = self._values, len(statements)
        pairs = [(x.targets[0], x.value) for x in statements if isinstance(x, ast.Assign)]
        calls = [call for _, call in pairs if isinstance(call, ast.Call)]
        given = [[self._value(x, env) for x in call.args] for call in calls]
        name = ast.unparse(calls[0].func)
        reals = all(getattr(x, "type", None) == DOUBLE for x in chain(*given))
        if name in self._outlined or not reals:
            results = [self._evaluate_call(name, arguments) for arguments in given]
        else:
            given += given[:1] * (lanes % 2)  # vectors have an even number of lanes
            columns = zip(*given, strict=True)
            vectors = [values.build_vector([*column]) for column in columns]
            self._width = len(given)
            result = self._inline(self._text.functions[name], vectors)
            self._width = 0
            parts = result if isinstance(result, list) else [result]
            rows = [
                [x if is_known(x) else values.element(x, lane) for x in parts]
                for lane in range(lanes)
            ]
            results = rows if isinstance(result, list) else [x for (x,) in rows]
        for (target, _), value in zip(pairs, results, strict=True):
            self._assign(target, value, env)
        return False

    def _store_target(self, target: Any, place: Any, value: Any, env: Env) -> None:
        if place is not None:
            if not isinstance(place[0], Array):
                raise UnsupportedConstruct("an assignment into something else")
            if self._mask is not None and not (
                self._is_final_branch and self._is_in_scratch(target, env)
            ):
                value = self._values.choose(self._mask, value, self._read(place))
            self._values.store(place[0], place[1], value, self._width)
        elif isinstance(slot := env.get(target.id), Slot):
            if self._mask is not slot.mask:
                value = self._values.choose(self._mask, value, self._values.read(slot))
            self._values.write(slot, value)
        else:
            env[target.id] = value

    def _if(self, truth: Any, body: Any, other: Any, env: Env) -> bool:
        if is_known(truth):
            return self._walk_final(body if truth else other, env)
        self._make_variables(assigned([*body, *other]), env)
        names = set(env)
        frame = self._frames[-1]

        def way(statements: Any) -> Callable[[], bool]:
            def walk() -> bool:
                return self._walk_final(statements, dict(env))

            return walk

        frame.depth += 1
        if isinstance(truth.type, ir.VectorType):
            left = False
            around, self._is_final_branch = self._is_final_branch, body is self._rest
            self._branch_by_masks(truth, way(body), way(other) if other else None)
            self._is_final_branch = around
        else:
            left = self._values.branch(truth, way(body), way(other))
        frame.depth -= 1
        for name in set(env) - names:
            del env[name]
        return left

    def _branch_by_masks(
        self, truth: Any, yes: Callable[[], bool], other: Callable[[], bool] | None
    ) -> None:
        """Emit both branches; each runs if at least one lane takes it."""
        around, values = self._mask, self._values
        for mask, way in ((truth, yes), (values.logical_not(truth), other)):
            if way is not None:
                self._mask = mask if around is None else values.logical_and(around, mask)
                values.branch(values.any(self._mask), way, lambda: False)
                self._mask = around

    def _is_in_scratch(self, target: Any, env: Env) -> bool:
        """Return True if a target is a row of a scratch block."""
        match target:
            case ast.Subscript(value=ast.Name(id="W"), slice=ast.Tuple(elts=[row, _])):
                while isinstance(row, ast.BinOp) and isinstance(row.op, ast.Add):
                    row = row.left
                first = env.get(row.id, row.id) if isinstance(row, ast.Name) else None
                scratch = self._text.scratch
                return first in scratch or any(first in rows for rows in scratch.values())
        return False

    def _make_variables(self, names: frozenset[str], env: Env) -> None:
        """Turn names that a loop or a branch will change into variables in memory."""
        for name in sorted(names & set(env)):
            if isinstance(env[name], Product):
                env[name] = self._look_up(name, env)
            if not isinstance(env[name], Slot):
                try:
                    env[name] = self._values.slot(env[name], self._width, self._mask)
                except UnsupportedConstruct:
                    del env[name]  # the text must assign it again before it reads it
