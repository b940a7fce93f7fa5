"""The walker visits the syntax tree of a kernel and emits an instruction for each operation.

It inlines functions at their calls. It evaluates known values at once: entries of tables, numbers
of rows, and conditions on them. It unrolls short loops over constants. Long loops, and loops whose
ends are unknown, stay loops. A loop over adjacent rows, whose turns are independent, becomes vector
instructions.
"""

from __future__ import annotations

import ast
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from symsimpson.errors import GenerationError
from symsimpson.targets.llvm.assigning import Assignments
from symsimpson.targets.llvm.control_flow import Loop, Slot
from symsimpson.targets.llvm.expressions import Env, Frame, Product, ScratchUse
from symsimpson.targets.llvm.memory import Array
from symsimpson.targets.llvm.trees import assigned, can_vectorise, leaves, weight
from symsimpson.targets.llvm.values import LaneNumber, UnsupportedConstruct, is_known
from symsimpson.targets.llvm.vectors import private_blocks
from symsimpson.text.interface import LOOKED_AT, PIVOTED

#: Numbers of turns that can become one vector.
WIDTHS = (4, 8, 16)
#: The largest size of private scratch rows of all lanes, in numbers; they are on the stack.
MOST_OWN = 16_384


class Walker(Assignments):
    """Visits the functions of a text, and emits their instructions."""

    _private_scratch = False
    #: Number of lanes that are one vector in a kernel; 0 if each lane has its own instructions.
    _lane_vector = 0

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
        """Emit a kernel for all lanes; ``vector`` makes all lanes one vector.

        With ``lane_scratch``, loops may become vectors whose lanes have private scratch rows.
        Functions named in ``alone`` are emitted for one lane after another. Raises GenerationError,
        with the line, if the text has an unsupported construct. Raises UnsupportedConstruct if the
        lanes cannot be one vector.
        """
        lanes, self._private_scratch, self._scalar_functions = (
            workspace.shape[1],
            lane_scratch,
            alone,
        )
        self._lane_vector = lanes if vector else 0
        # if there is a kernel with pivots, only that kernel fails finally, and needs all rows
        if name not in LOOKED_AT or (name == "newton" and PIVOTED in self._text.functions):
            self._values.is_live = lambda place: self._is_live(place // lanes)
        self._unrolls_all = name in self._text.constants.get("STRAIGHT", ())
        if self._unrolls_all:
            self._few = self._weight(self._text.functions[name].body)
        env: Env = {"h": h, "t": t, "LANES": lanes}
        self._frames.append(Frame(self._text.functions[name]))
        body = self._text.functions[name].body
        match body[-1]:
            case ast.For(target=ast.Name(id="lane"), body=[*_, ast.If(body=rest, orelse=[])]):
                self._rest = rest if vector else None
        for k, statement in enumerate(body):
            self._ahead.append(self._scratch_use_at(body, k))
            match statement:
                case ast.Assign(targets=[ast.Name(id="W")]):
                    env["W"] = workspace
                case _:
                    self._statement(statement, env)
            self._ahead.pop()
        self._frames.pop()

    def _scratch_use_at(self, body: Sequence[ast.stmt], k: int) -> ScratchUse:
        """Return the scratch blocks that statement k of a block uses, and those used after it."""
        if body[0] not in self._scratch_from:
            behind = [frozenset[str]()]
            for statement in reversed(body):
                behind.append(behind[-1] | self._scratch_names(statement))
            self._scratch_from[body[0]] = behind[::-1]
        return ScratchUse(self._scratch_from[body[0]][k + 1], self._scratch_names(body[k]))

    def _is_live(self, row: int) -> bool:
        """Return True if a later statement may read a row, or the row is not scratch."""
        block = next((name for name, rows in self._text.scratch.items() if row in rows), None)
        return block is None or any(
            block in ahead.after or block in ahead.here for ahead in self._ahead
        )

    def _scratch_names(self, node: ast.AST) -> frozenset[str]:
        """Return the scratch blocks that a statement and the functions that it calls name."""
        scratch = self._names.get(node)
        if scratch is None:
            names = {part.id for part in ast.walk(node) if isinstance(part, ast.Name)}
            functions = [
                self._text.functions[name] for name in names if name in self._text.functions
            ]
            named = frozenset(names & self._text.scratch.keys())
            self._names[node] = named  # ends the recursion if a function names itself
            scratch = self._names[node] = named.union(*map(self._scratch_names, functions))
        return scratch

    def function(self, name: str, arguments: list[Any]) -> Any:
        """Emit a function, and return its result.

        Raises GenerationError, with the line, if the text has an unsupported construct.
        """
        return self._inline(self._text.functions[name], arguments)

    # -- statements

    def _block(self, body: Sequence[ast.stmt], env: Env) -> bool:
        """Emit the statements of a block; return True if they leave it."""
        for k, statements in self._ordered_statements(body):
            self._ahead.append(self._scratch_use_at(body, k))
            left = self._statement(statements[0], env, statements[1:])
            self._ahead.pop()
            if left:
                return True
        return False

    def _walk_final(self, body: Sequence[ast.stmt], env: Env) -> bool:
        """Emit statements that end the present one, so that it uses no scratch after them."""
        here = self._ahead[-1]
        self._ahead[-1] = ScratchUse(here.after, frozenset())
        left = self._block(body, env)
        self._ahead[-1] = here
        return left

    def _statement(self, node: ast.stmt, env: Env, beside: Sequence[ast.stmt] = ()) -> bool:
        """Emit a statement and similar calls ``beside`` it; return True if it leaves the block."""
        try:
            return (
                self._vectorise_calls([node, *beside], env) if beside else self._execute(node, env)
            )
        except UnsupportedConstruct as refused:
            refused.function = refused.function or self._frames[-1].name
            if self._width or self._scalar_functions:
                raise
            raise GenerationError(
                f"line {node.lineno}: the kernel has {refused}: {ast.unparse(node)[:80]}"
            ) from None

    def _execute(self, node: ast.stmt, env: Env) -> bool:
        """Emit one statement; return True if it leaves the block."""
        match node:
            case ast.Expr(value=ast.Constant()) | ast.Pass():
                return False
            case ast.Expr(value=ast.Call(func=ast.Name(id=name), args=arguments)) if (
                name in self._text.functions and name not in self._outlined
            ):
                given = [self._value(x, env) for x in arguments]
                here, passed = self._ahead[-1], map(self._scratch_names, arguments)
                self._ahead[-1] = ScratchUse(here.after.union(*passed), here.here)
                self._inline(self._text.functions[name], given, last=True)
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
                before = self._read_target(target, place, env)
                self._store_target(
                    target, place, self._augmented_value(before, op, value, env), env
                )
            case ast.If(test=test, body=body, orelse=other):
                return self._if(self._value(test, env), body, other, env)
            case ast.For():
                self._for(node, env)
            case ast.While(test=test, body=body, orelse=[]):
                self._while(test, body, env)
            case ast.Break() | ast.Continue():
                loop = self._frames[-1].loops[-1]
                if loop.mask is not self._mask:
                    raise UnsupportedConstruct("a loop that some of the lanes leave")
                broken = isinstance(node, ast.Break)
                self._values.builder.branch(loop.after if broken else loop.following)
                return True
            case ast.Return(value=value):
                return self._leave(None if value is None else self._value(value, env))
            case _:
                raise UnsupportedConstruct(f"a statement of type {type(node).__name__}")
        return False

    # -- loops

    def _for(self, node: ast.For, env: Env) -> None:
        match node:
            case ast.For(target=ast.Name(id="lane")) if self._lane_vector and not self._width:
                self._width = self._lane_vector
                self._walk_final(node.body, env | {"lane": LaneNumber(0)})
                self._width = 0
                return
            case ast.For(
                target=ast.Name(id=name), iter=ast.Call(func=ast.Name(id="range"), args=arguments)
            ):
                ends = [self._value(end, env) for end in arguments]
            case ast.For(target=ast.Name(id=name), iter=ast.Name(id=table)):
                for entry in self._look_up(table, env):
                    env[name] = entry
                    self._block(node.body, env)
                return
            case _:
                raise UnsupportedConstruct("a loop over something else")
        first, end, step = ([0, *ends, 1] if len(ends) == 1 else [*ends, 1])[:3]
        if is_known(first) and is_known(end):
            turns = range(first, end, step)
            if not turns:
                return
            if step == 1 and (
                self._vectorise_loop(node, name, turns, env)
                or self._vectorise_privately(node, name, turns, env)
            ):
                return
            few = len(turns) == 1 or len(turns) * self._weight(node.body) <= self._few
            if few and not leaves(node):
                for number in turns:
                    env[name] = number
                    walk = self._walk_final if number == turns[-1] else self._block
                    if walk(node.body, env):
                        raise UnsupportedConstruct("a loop that is left")
                return
        self._emit_loop(node, name, (first, end, step), env)

    def _emit_loop(self, node: ast.For, name: str, ends: Any, env: Env) -> None:
        """Emit a loop that is neither unrolled nor vectorised."""
        self._make_variables(assigned(node.body) - {name}, env)
        local_env = dict(env)

        def body(number: Any, loop: Loop) -> bool:
            return self._turn(node.body, local_env | {name: number}, loop)

        self._values.loop(ends, body)
        env.pop(name, None)

    def _while(self, test: ast.expr, statements: Any, env: Env) -> None:
        self._make_variables(assigned(statements), env)
        local_env = dict(env)

        def body(loop: Loop) -> bool:
            return self._turn(statements, dict(local_env), loop)

        self._values.repeat(lambda: self._value(test, dict(local_env)), body)

    def _turn(self, statements: Any, env: Env, loop: Loop) -> bool:
        """Emit one turn of a loop; return True if it ends with a break or continue."""
        frame = self._frames[-1]
        frame.depth += 1
        frame.loops.append(replace(loop, mask=self._mask))
        left = self._block(statements, env)
        frame.loops.pop()
        frame.depth -= 1
        return left

    def _vectorise_loop(self, node: ast.For, name: str, turns: range, env: Env) -> bool:
        """Emit a loop as vector instructions; return False if this is impossible.

        Its turns must be independent and use adjacent rows. In an unrolled kernel, rows are single
        values, and vectors of them would need extra instructions.
        """
        if (
            self._unrolls_all
            or self._width
            or len(turns) not in WIDTHS
            or not self._has_one_lane(env)
        ):
            return False
        constants = {key: value for key, value in env.items() if isinstance(value, int)}
        if not can_vectorise(node, name, turns, self._text, constants):
            return False
        local_env = env | {name: LaneNumber(turns.start)}
        self._width = len(turns)
        try:
            self._block(node.body, local_env)
        finally:
            self._width = 0
        for variable in assigned(node.body):  # after the loop, they differ from lane to lane
            env.pop(variable, None)
        return True

    def _vectorise_privately(self, node: ast.For, name: str, turns: range, env: Env) -> bool:
        """Emit a loop as vector instructions whose lanes have private scratch rows.

        Return False if this is impossible.
        """
        width, text = len(turns), self._text
        if self._width or not self._private_scratch or not self._has_one_lane(env):
            return False
        if width not in WIDTHS or turns != range(text.constants.get("STRIDE", 0)):
            return False
        blocks = private_blocks(node, name, text)
        if not blocks or sum(len(text.blocks[x]) for x in blocks) * width > MOST_OWN:
            return False
        values = self._values
        self._private_rows = lane_rows = {
            x: values.private_rows(len(text.blocks[x]), width) for x in sorted(blocks)
        }
        self._width = width
        self._block(node.body, env | {name: LaneNumber(turns.start)})
        self._width, self._private_rows = 0, {}
        for variable in assigned(node.body):  # after the loop, they differ from lane to lane
            env.pop(variable, None)
        around = [*(ahead.here for ahead in self._ahead[:-1]), *(x.after for x in self._ahead)]
        left = {x for x in blocks if x not in text.scratch or any(x in names for names in around)}
        for block in sorted(left):  # later statements read the rows of the last turn
            for k, row in enumerate(text.blocks[block]):
                last = values.element(
                    values.load(env["W"], [values.add(lane_rows[block], k), 0], 0), width - 1
                )
                values.store(env["W"], [row, 0], last, 0)
        return True

    @staticmethod
    def _has_one_lane(env: Env) -> bool:
        """Return True if the workspace has one lane, so that its rows are contiguous."""
        workspace = env.get("W")
        return isinstance(workspace, Array) and workspace.strides == (1, 1)

    def _weight(self, body: Any) -> int:
        return sum(weight(statement, self._text) for statement in body)

    def _inline(
        self, function: ast.FunctionDef, arguments: list[Any], *, last: bool = False
    ) -> Any:
        """Emit a function at its call; ``last`` says that the call ends a statement."""
        if self._width and function.name in self._scalar_functions:
            return self._walk_each_lane(function, arguments)
        env = dict(zip([parameter.arg for parameter in function.args.args], arguments, strict=True))
        frame, values = Frame(function, self._mask), self._values
        self._frames.append(frame)
        left = (self._walk_final if last else self._block)(function.body, env)
        self._frames.pop()
        if frame.exit is not None:
            builder = values.builder
            if not (left and builder.block.is_terminated):
                builder.branch(frame.exit)
            builder.position_at_end(frame.exit)
        if frame.freed and _has_array(frame.result):
            raise GenerationError(
                f"{function.name} returns an array, but frees the arrays that it allocates."
            )
        values.release(frame.freed)
        if isinstance(frame.result, list):
            return [values.read(x) if isinstance(x, Slot) else x for x in frame.result]
        return values.read(frame.result) if isinstance(frame.result, Slot) else frame.result

    def _walk_each_lane(self, function: ast.FunctionDef, arguments: list[Any]) -> None:
        """Emit a function in a loop over lanes, although its caller has vectors."""
        values, width, mask = self._values, self._width, self._mask
        self._width, self._mask = 0, None

        def body(number: Any, loop: Loop) -> bool:
            def walk() -> bool:
                lane_arguments = (
                    values.add(x.first, number) if isinstance(x, LaneNumber) else x
                    for x in arguments
                )
                if self._inline(function, [*lane_arguments]) is not None:
                    raise UnsupportedConstruct("a function with a result in a loop over lanes")
                return False

            if mask is None:
                return walk()
            return values.branch(values.element(mask, number), walk, lambda: False)

        values.loop((0, width, 1), body)
        self._width, self._mask = width, mask


def _has_array(value: Any) -> bool:
    """Return True if a result is or contains an array."""
    if isinstance(value, list):
        return any(map(_has_array, value))
    return isinstance(value, Array)
