"""The walker: it goes through the syntax tree of a kernel and does with values what stands there.

Functions are walked where they are called. What is known while walking is computed at once: entries
of tables, rows, conditions on them. Short loops over constants are walked again and again; long
ones, and those whose ends are not known, stay loops. A loop over neighbouring rows, whose turns do
not depend on each other, is walked once, with vectors.
"""

from __future__ import annotations

import ast
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from symsimpson.errors import GenerationError
from symsimpson.targets.llvm.assigning import Assigning
from symsimpson.targets.llvm.control_flow import Loop, Slot
from symsimpson.targets.llvm.expressions import Ahead, Env, Frame, Product
from symsimpson.targets.llvm.memory import Array
from symsimpson.targets.llvm.trees import assigned, leaves, vectors, weight
from symsimpson.targets.llvm.values import LaneNumber, Refused, known
from symsimpson.targets.llvm.vectors import own_blocks
from symsimpson.text.interface import LOOKED_AT, PIVOTED

#: As many turns are made to one vector.
WIDTHS = (4, 8, 16)
#: Lanes have no more scratch of their own, in numbers: it stands on the stack.
MOST_OWN = 16_384


class Walker(Assigning):
    """Walks functions of a text."""

    _lanes_own = False
    #: Lanes that are one vector in a kernel; 0 where they are walked one by one.
    _side_by_side = 0

    def kernel(
        self,
        name: str,
        h: Any,
        t: Any,
        workspace: Array,
        *,
        vector: bool,
        lane_scratch: bool = False,
        alone: frozenset[str] = frozenset(),
    ) -> None:
        """Walk a kernel for all lanes, as one vector if that is wanted.

        Loops may be vectors of which each lane has scratch of its own, if that is. Functions that
        are ``alone`` are walked for one lane after another. Raises GenerationError if the text has
        something that no kernel has, with the line; Refused if lanes cannot be one vector.
        """
        lanes, self._lanes_own, self._alone = workspace.shape[1], lane_scratch, alone
        self._side_by_side = lanes if vector else 0
        # a step fails for good in the kernel with pivots, if there is one
        if name not in LOOKED_AT or (name == "newton" and PIVOTED in self._text.functions):
            self._values.wanted = lambda place: self._wanted(place // lanes)
        self._straight = name in self._text.constants.get("STRAIGHT", ())
        if self._straight:
            self._few = self._weight(self._text.functions[name].body)
        env: Env = {"h": h, "t": t, "LANES": lanes}
        self._frames.append(Frame(self._text.functions[name]))
        body = self._text.functions[name].body
        match body[-1]:
            case ast.For(target=ast.Name(id="lane"), body=[*_, ast.If(body=rest, orelse=[])]):
                self._rest = rest if vector else None
        for k, statement in enumerate(body):
            self._ahead.append(self._ahead_of(body, k))
            match statement:
                case ast.Assign(targets=[ast.Name(id="W")]):
                    env["W"] = workspace
                case _:
                    self._statement(statement, env)
            self._ahead.pop()
        self._frames.pop()

    def _ahead_of(self, body: Sequence[ast.stmt], k: int) -> Ahead:
        """Return what scratch is named in a statement of a block, and in those behind it."""
        if body[0] not in self._behind:
            behind = [frozenset[str]()]
            for statement in reversed(body):
                behind.append(behind[-1] | self._mentioned(statement))
            self._behind[body[0]] = behind[::-1]
        return Ahead(self._behind[body[0]][k + 1], self._mentioned(body[k]))

    def _wanted(self, row: int) -> bool:
        """Return whether a row is no scratch, or statements that follow name its block."""
        block = next((name for name, rows in self._text.scratch.items() if row in rows), None)
        return block is None or any(
            block in ahead.after or block in ahead.here for ahead in self._ahead
        )

    def _mentioned(self, node: ast.AST) -> frozenset[str]:
        """Return the scratch that is named in a statement, and in the functions that it calls."""
        scratch = self._names.get(node)
        if scratch is None:
            names = {part.id for part in ast.walk(node) if isinstance(part, ast.Name)}
            functions = [
                self._text.functions[name] for name in names if name in self._text.functions
            ]
            named = frozenset(names & self._text.scratch.keys())
            self._names[node] = named  # a function may have a value of its own name
            scratch = self._names[node] = named.union(*map(self._mentioned, functions))
        return scratch

    def function(self, name: str, arguments: list[Any]) -> Any:
        """Walk a function, and return its result.

        Raises GenerationError if the text has something that is not known, with the line.
        """
        return self._inside(self._text.functions[name], arguments)

    # -- statements

    def _block(self, body: Sequence[ast.stmt], env: Env) -> bool:
        """Walk statements; returns whether the function was left."""
        for k, statements in self._in_order(body):
            self._ahead.append(self._ahead_of(body, k))
            left = self._statement(statements[0], env, statements[1:])
            self._ahead.pop()
            if left:
                return True
        return False

    def _last(self, body: Sequence[ast.stmt], env: Env) -> bool:
        """Walk the last statements of the present one: nothing of it is left behind them."""
        here = self._ahead[-1]
        self._ahead[-1] = Ahead(here.after, frozenset())
        left = self._block(body, env)
        self._ahead[-1] = here
        return left

    def _statement(self, node: ast.stmt, env: Env, beside: Sequence[ast.stmt] = ()) -> bool:
        """Walk a statement, and others that stand beside it; returns whether they left."""
        try:
            return self._together([node, *beside], env) if beside else self._do(node, env)
        except Refused as refused:
            refused.function = refused.function or self._frames[-1].name
            if self._width or self._alone:
                raise
            raise GenerationError(
                f"line {node.lineno}: the kernel has {refused}: {ast.unparse(node)[:80]}"
            ) from None

    def _do(self, node: ast.stmt, env: Env) -> bool:
        match node:
            case ast.Expr(value=ast.Constant()) | ast.Pass():
                return False
            case ast.Expr(value=ast.Call(func=ast.Name(id=name), args=arguments)) if (
                name in self._text.functions and name not in self._apart
            ):
                given = [self._value(x, env) for x in arguments]
                here, passed = self._ahead[-1], map(self._mentioned, arguments)
                self._ahead[-1] = Ahead(here.after.union(*passed), here.here)
                self._inside(self._text.functions[name], given, last=True)
            case ast.Expr(value=value):
                self._value(value, env)
            case ast.Assign(
                targets=[ast.Name(id=name)], value=ast.BinOp(left=left, op=ast.Mult(), right=right)
            ) if name in self._frames[-1].once and not isinstance(env.get(name), Slot):
                env[name] = Product(self._value(left, env), self._value(right, env))
            case ast.Assign(targets=[target], value=value):
                self._assign(target, self._value(value, env), env)
            case ast.AugAssign(target=target, op=op, value=value):
                place = self._places(target, env)
                before = self._at(target, place, env)
                self._put(target, place, self._changed(before, op, value, env), env)
            case ast.If(test=test, body=body, orelse=other):
                return self._if(self._value(test, env), body, other, env)
            case ast.For():
                self._for(node, env)
            case ast.While(test=test, body=body, orelse=[]):
                self._while(test, body, env)
            case ast.Break() | ast.Continue():
                loop = self._frames[-1].loops[-1]
                if loop.mask is not self._mask:
                    raise Refused("a loop that some of the lanes leave")
                broken = isinstance(node, ast.Break)
                self._values.builder.branch(loop.after if broken else loop.following)
                return True
            case ast.Return(value=value):
                return self._leave(None if value is None else self._value(value, env))
            case _:
                raise Refused(f"a statement of type {type(node).__name__}")
        return False

    # -- loops

    def _for(self, node: ast.For, env: Env) -> None:
        match node:
            case ast.For(target=ast.Name(id="lane")) if self._side_by_side and not self._width:
                self._width = self._side_by_side
                self._last(node.body, env | {"lane": LaneNumber(0)})
                self._width = 0
                return
            case ast.For(
                target=ast.Name(id=name), iter=ast.Call(func=ast.Name(id="range"), args=arguments)
            ):
                ends = [self._value(end, env) for end in arguments]
            case ast.For(target=ast.Name(id=name), iter=ast.Name(id=table)):
                for entry in self._named(table, env):
                    env[name] = entry
                    self._block(node.body, env)
                return
            case _:
                raise Refused("a loop over something else")
        first, end, step = ([0, *ends, 1] if len(ends) == 1 else [*ends, 1])[:3]
        if known(first) and known(end):
            turns = range(first, end, step)
            if not turns:
                return
            if step == 1 and (
                self._as_vector(node, name, turns, env) or self._with_own(node, name, turns, env)
            ):
                return
            few = len(turns) == 1 or len(turns) * self._weight(node.body) <= self._few
            if few and not leaves(node):
                for number in turns:
                    env[name] = number
                    walk = self._last if number == turns[-1] else self._block
                    if walk(node.body, env):
                        raise Refused("a loop that is left")
                return
        self._keep(node, name, (first, end, step), env)

    def _keep(self, node: ast.For, name: str, ends: Any, env: Env) -> None:
        """Walk a loop that stays one."""
        self._let_change(assigned(node.body) - {name}, env)
        local_env = dict(env)

        def body(number: Any, loop: Loop) -> bool:
            return self._turn(node.body, local_env | {name: number}, loop)

        self._values.loop(ends, body)
        env.pop(name, None)

    def _while(self, test: ast.expr, statements: Any, env: Env) -> None:
        self._let_change(assigned(statements), env)
        local_env = dict(env)

        def body(loop: Loop) -> bool:
            return self._turn(statements, dict(local_env), loop)

        self._values.repeat(lambda: self._value(test, dict(local_env)), body)

    def _turn(self, statements: Any, env: Env, loop: Loop) -> bool:
        """Walk one turn of a loop; returns whether it ends elsewhere."""
        frame = self._frames[-1]
        frame.depth += 1
        frame.loops.append(replace(loop, mask=self._mask))
        left = self._block(statements, env)
        frame.loops.pop()
        frame.depth -= 1
        return left

    def _as_vector(self, node: ast.For, name: str, turns: range, env: Env) -> bool:
        """Walk a loop with vectors, if its turns go along neighbouring rows and are independent.

        Rows of a kernel that is unrolled are values, which would have to be put together.
        """
        if self._straight or self._width or len(turns) not in WIDTHS or not self._single(env):
            return False
        constants = {key: value for key, value in env.items() if isinstance(value, int)}
        if not vectors(node, name, turns, self._text, constants):
            return False
        local_env = env | {name: LaneNumber(turns.start)}
        self._width = len(turns)
        try:
            self._block(node.body, local_env)
        finally:
            self._width = 0
        for variable in assigned(node.body):  # they have no one value behind it
            env.pop(variable, None)
        return True

    def _with_own(self, node: ast.For, name: str, turns: range, env: Env) -> bool:
        """Walk a loop with vectors, of which each lane has scratch of its own."""
        width, text = len(turns), self._text
        if self._width or not self._lanes_own or not self._single(env):
            return False
        if width not in WIDTHS or turns != range(text.constants.get("STRIDE", 0)):
            return False
        blocks = own_blocks(node, name, text)
        if not blocks or sum(len(text.blocks[x]) for x in blocks) * width > MOST_OWN:
            return False
        values = self._values
        self._own = lane_rows = {
            x: values.own_rows(len(text.blocks[x]), width) for x in sorted(blocks)
        }
        self._width = width
        self._block(node.body, env | {name: LaneNumber(turns.start)})
        self._width, self._own = 0, {}
        for variable in assigned(node.body):  # they have no one value behind it
            env.pop(variable, None)
        around = [*(ahead.here for ahead in self._ahead[:-1]), *(x.after for x in self._ahead)]
        left = {x for x in blocks if x not in text.scratch or any(x in names for names in around)}
        for block in sorted(left):  # as the last turn leaves it
            for k, row in enumerate(text.blocks[block]):
                last = values.element(
                    values.load(env["W"], [values.add(lane_rows[block], k), 0], 0), width - 1
                )
                values.store(env["W"], [row, 0], last, 0)
        return True

    @staticmethod
    def _single(env: Env) -> bool:
        """Return whether rows of the workspace stand beside each other."""
        workspace = env.get("W")
        return isinstance(workspace, Array) and workspace.strides == (1, 1)

    def _weight(self, body: Any) -> int:
        return sum(weight(statement, self._text) for statement in body)

    def _inside(
        self, function: ast.FunctionDef, arguments: list[Any], *, last: bool = False
    ) -> Any:
        """Walk a function where it is called; it may be the last of a statement."""
        if self._width and function.name in self._alone:
            return self._by_lanes(function, arguments)
        env = dict(zip([parameter.arg for parameter in function.args.args], arguments, strict=True))
        frame, values = Frame(function, self._mask), self._values
        self._frames.append(frame)
        left = (self._last if last else self._block)(function.body, env)
        self._frames.pop()
        if frame.exit is not None:
            builder = values.builder
            if not (left and builder.block.is_terminated):
                builder.branch(frame.exit)
            builder.position_at_end(frame.exit)
        if frame.freed and _has_array(frame.result):
            raise GenerationError(f"{function.name} gives back an array; it frees those it makes.")
        values.release(frame.freed)
        if isinstance(frame.result, list):
            return [values.read(x) if isinstance(x, Slot) else x for x in frame.result]
        return values.read(frame.result) if isinstance(frame.result, Slot) else frame.result

    def _by_lanes(self, function: ast.FunctionDef, arguments: list[Any]) -> None:
        """Walk a function for one lane after another, where others are done at once."""
        values, width, mask = self._values, self._width, self._mask
        self._width, self._mask = 0, None

        def body(number: Any, loop: Loop) -> bool:
            def walk() -> bool:
                lane_arguments = (
                    values.add(x.first, number) if isinstance(x, LaneNumber) else x
                    for x in arguments
                )
                if self._inside(function, [*lane_arguments]) is not None:
                    raise Refused("a result of one lane after another")
                return False

            if mask is None:
                return walk()
            return values.branch(values.element(mask, number), walk, lambda: False)

        values.loop((0, width, 1), body)
        self._width, self._mask = width, mask


def _has_array(value: Any) -> bool:
    """Return whether a result is an array, or has one in it."""
    if isinstance(value, list):
        return any(map(_has_array, value))
    return isinstance(value, Array)
