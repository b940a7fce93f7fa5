"""The walker: it goes through the syntax tree of a kernel and does with values what stands there.

Functions are walked where they are called. What is known while walking is computed at once: entries
of tables, rows, conditions on them. Short loops over constants are walked again and again; long
ones, and those whose ends are not known, stay loops. A loop over neighbouring rows, whose turns do
not depend on each other, is walked once, with vectors.
"""

from __future__ import annotations

import ast
from collections.abc import Callable, Sequence
from typing import Any

from symsimpson.errors import GenerationError
from symsimpson.walk.blocks import Blocks, Slot
from symsimpson.walk.text import Text
from symsimpson.walk.trees import assigned, reads_rows, vectors, weight
from symsimpson.walk.values import KNOWN, Along, Refused, known

__all__ = ["Walker"]

#: A loop over constants with fewer operations in all its turns is walked turn by turn.
FEW = 400
#: As many turns are made to one vector.
WIDTHS = (4, 8, 16)

Env = dict[str, Any]
COMPARED = {ast.Lt: "<", ast.LtE: "<=", ast.Gt: ">", ast.GtE: ">=", ast.Eq: "==", ast.NotEq: "!="}


class Frame:
    """A function that is being walked: where it is left to, and how deep in branches it is."""

    def __init__(self) -> None:
        self.exit: Any = None
        self.depth = 0
        self.result: Any = None


class Walker:
    """Walks kernels of a text.

    Parameters
    ----------
    text : Text
    values : Blocks
    call : callable
        Calls a function of ``math`` with one value that is no vector.
    """

    def __init__(self, text: Text, values: Blocks, call: Callable[[Any, list[Any]], Any]) -> None:
        self._text, self._values, self._call = text, values, call
        self._width = 0
        self._frames: list[Frame] = []

    def kernel(self, name: str, h: Any, t: Any, lanes: int, *, vector: bool) -> None:
        """Walk a kernel for all lanes, as one vector if that is wanted.

        Raises
        ------
        GenerationError
            If the text has something that no kernel has, with the line.
        Refused
            If lanes cannot be one vector.
        """
        env: Env = {"h": h, "t": t, "workspace": None, "LANES": lanes}
        for statement in self._text.functions[name].body:
            match statement:
                case ast.Assign(targets=[ast.Name(id="W")]):
                    env["W"] = None
                case ast.For(target=ast.Name(id="lane")) if vector:
                    self._width = lanes
                    env["lane"] = Along(0)
                    self._frames.append(Frame())
                    self._block(statement.body, env)
                    self._frames.pop()
                    self._width = 0
                case _:
                    self._frames.append(Frame())
                    self._statement(statement, env)
                    self._frames.pop()

    # -- statements

    def _block(self, body: Sequence[ast.stmt], env: Env) -> bool:
        """Walk statements; returns whether the function was left."""
        return any(self._statement(statement, env) for statement in body)

    def _statement(self, node: ast.stmt, env: Env) -> bool:
        try:
            return self._do(node, env)
        except Refused as refused:
            if self._width:
                raise
            raise GenerationError(
                f"line {node.lineno}: the kernel has {refused}: {ast.unparse(node)[:80]}"
            ) from None

    def _do(self, node: ast.stmt, env: Env) -> bool:
        match node:
            case ast.Expr(value=ast.Constant()) | ast.Pass():
                return False
            case ast.Expr(value=value):
                self._value(value, env)
            case ast.Assign(targets=[ast.Tuple(elts=targets)], value=value):
                for target, one in zip(targets, self._value(value, env), strict=True):
                    self._assign(target, one, env)
            case ast.Assign(targets=[target], value=value):
                self._assign(target, self._value(value, env), env)
            case ast.AugAssign(target=target, op=op, value=value):
                place = self._places(target, env)
                before = self._at(target, place, env)
                self._put(target, place, self._binary(op, before, self._value(value, env)), env)
            case ast.If(test=test, body=body, orelse=other):
                return self._if(self._value(test, env), body, other, env)
            case ast.For():
                self._for(node, env)
            case ast.Return(value=value):
                return self._leave(None if value is None else self._value(value, env))
            case _:
                raise Refused(f"a statement of type {type(node).__name__}")
        return False

    def _leave(self, result: Any) -> bool:
        frame = self._frames[-1]
        if not frame.depth:
            frame.result = result
        elif result is not None:
            raise Refused("a result in a branch")
        else:
            frame.exit = frame.exit or self._values.exit_block()
            self._values.builder.branch(frame.exit)
        return True

    def _assign(self, target: ast.expr, value: Any, env: Env) -> None:
        self._put(target, self._places(target, env), value, env)

    def _places(self, target: ast.expr, env: Env) -> Any:
        """Return row and lane of a place in the workspace; None for a name."""
        match target:
            case ast.Name():
                return None
            case ast.Subscript(value=ast.Name(id="W"), slice=ast.Tuple(elts=[row, lane])):
                return self._value(row, env), self._value(lane, env)
        raise Refused("an assignment to something else")

    def _at(self, target: Any, place: Any, env: Env) -> Any:
        if place is None:
            return self._named(target.id, env)
        return self._values.load(place, self._width)

    def _put(self, target: Any, place: Any, value: Any, env: Env) -> None:
        if place is not None:
            self._values.store(place, value, self._width)
        elif isinstance(env.get(target.id), Slot):
            self._values.write(env[target.id], value)
        else:
            env[target.id] = value

    # -- branches and loops

    def _if(self, truth: Any, body: Any, other: Any, env: Env) -> bool:
        if known(truth):
            return self._block(body if truth else other, env)
        self._let_change(assigned([*body, *other]), env)
        names = set(env)
        frame = self._frames[-1]

        def way(statements: Any) -> Callable[[], bool]:
            def walk() -> bool:
                own = dict(env)
                return self._block(statements, own)

            return walk

        frame.depth += 1
        left = self._values.branch(truth, way(body), way(other))
        frame.depth -= 1
        for name in set(env) - names:
            del env[name]
        return left

    def _let_change(self, names: frozenset[str], env: Env) -> None:
        """Make variables of what has a value and is going to change."""
        for name in sorted(names & set(env)):
            if not isinstance(env[name], Slot):
                try:
                    env[name] = self._values.slot(env[name], self._width)
                except Refused:
                    del env[name]  # set anew before it is read, or it is missed there

    def _for(self, node: ast.For, env: Env) -> None:
        match node:
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
            if step == 1 and self._as_vector(node, name, turns, env):
                return
            if len(turns) <= 1 or len(turns) * self._weight(node.body, env) <= FEW:
                for number in turns:
                    env[name] = number
                    self._block(node.body, env)
                return
        self._keep(node, name, (first, end, step), env)

    def _keep(self, node: ast.For, name: str, ends: Any, env: Env) -> None:
        """Walk a loop that stays one."""
        inside = assigned(node.body) - {name}
        self._let_change(inside, env)
        own = dict(env)

        def body(number: Any) -> None:
            turn = dict(own)
            turn[name] = number
            if self._block(node.body, turn):
                raise Refused("a loop that is left")

        frame = self._frames[-1]
        frame.depth += 1
        self._values.loop(ends, body)
        frame.depth -= 1
        env.pop(name, None)

    def _as_vector(self, node: ast.For, name: str, turns: range, env: Env) -> bool:
        """Walk a loop with vectors, if its turns go along neighbouring rows and are independent."""
        if self._width or self._values.lanes != 1 or len(turns) not in WIDTHS:
            return False
        constants = {key: value for key, value in env.items() if isinstance(value, int)}
        if not vectors(node, name, turns, self._text, constants):
            return False
        own = env | {name: Along(turns.start)}
        self._width = len(turns)
        try:
            self._block(node.body, own)
        finally:
            self._width = 0
        return True

    def _weight(self, body: Any, env: Env) -> int:
        return sum(weight(statement, self._text) for statement in body)

    # -- expressions

    def _named(self, name: str, env: Env) -> Any:
        if name in env:
            value = env[name]
            return self._values.read(value) if isinstance(value, Slot) else value
        try:
            return self._text.constants[name]
        except KeyError:
            raise Refused(f"{name}, which has no value here") from None

    def _value(self, node: ast.expr, env: Env) -> Any:
        values = self._values
        match node:
            case ast.Constant(value=value):
                return value
            case ast.Name(id=name):
                return self._named(name, env)
            case ast.BinOp(left=left, op=op, right=right):
                return self._binary(op, self._value(left, env), self._value(right, env))
            case ast.UnaryOp(op=ast.USub(), operand=operand):
                return values.negative(self._value(operand, env))
            case ast.UnaryOp(op=ast.Not(), operand=operand):
                return values.no(self._value(operand, env))
            case ast.Subscript(value=ast.Name(id="W")):
                return values.load(self._places(node, env), self._width)
            case ast.Subscript(value=ast.Name(id=name), slice=ast.Tuple(elts=places)):
                return values.entry(self._named(name, env), [self._value(x, env) for x in places])
            case ast.Subscript(value=ast.Name(id=name), slice=place):
                return values.entry(self._named(name, env), [self._value(place, env)])
            case ast.Compare(left=left, ops=[op], comparators=[right]):
                a, b = self._value(left, env), self._value(right, env)
                return values.compare(COMPARED[type(op)], a, b)
            case ast.BoolOp(op=op, values=parts):
                return self._truths(parts, env, settles=isinstance(op, ast.Or))
            case ast.IfExp(test=test, body=body, orelse=other):
                return self._either(self._value(test, env), body, other, env)
            case ast.Tuple(elts=parts):
                return [self._value(part, env) for part in parts]
            case ast.Call(func=ast.Name(id=name), args=arguments):
                return self._called(name, [self._value(x, env) for x in arguments], env)
        raise Refused(f"an expression of type {type(node).__name__}")

    def _binary(self, op: ast.operator, a: Any, b: Any) -> Any:
        values = self._values
        match op:
            case ast.Add():
                return values.add(a, b)
            case ast.Sub():
                return values.subtract(a, b)
            case ast.Mult():
                return values.multiply(a, b)
            case ast.Div():
                return values.divide(a, b)
            case ast.Pow():
                return values.power(a, b)
            case ast.BitAnd():
                return values.both(a, b)
            case ast.BitOr():
                return values.either(a, b)
            case ast.FloorDiv() if known(a) and known(b):
                return a // b
            case ast.Mod() if known(a) and known(b):
                return a % b
        raise Refused(f"an operation of type {type(op).__name__}")

    def _truths(self, parts: list[ast.expr], env: Env, *, settles: bool) -> Any:
        """Return whether all are true, or one of them; what settles it is the last one asked."""
        truth = self._value(parts[0], env)
        for part in parts[1:]:
            if known(truth):
                if bool(truth) is settles:
                    return truth
                truth = self._value(part, env)
                continue

            def rest(part: ast.expr = part) -> Any:
                return self._value(part, env)

            if self._width or not reads_rows(part):
                join = self._values.either if settles else self._values.both
                truth = join(truth, rest())
            elif settles:
                truth = self._values.picked(truth, lambda: True, rest)
            else:
                truth = self._values.picked(truth, rest, lambda: False)
        return truth

    def _either(self, truth: Any, body: ast.expr, other: ast.expr, env: Env) -> Any:
        if known(truth):
            return self._value(body if truth else other, env)

        def one() -> Any:
            return self._value(body, env)

        def two() -> Any:
            return self._value(other, env)

        if not self._width and (reads_rows(body) or reads_rows(other)):
            return self._values.picked(truth, one, two)
        return self._values.choose(truth, one(), two())

    # -- calls

    def _called(self, name: str, arguments: list[Any], env: Env) -> Any:
        values = self._values
        if name in self._text.functions:
            return self._inside(self._text.functions[name], arguments)
        match name, arguments:
            case (("real" | "float"), [value]):
                return float(value) if isinstance(value, (str, *KNOWN)) else values.real(value)
            case "int", [value]:
                return values.cut(value)
            case "abs", [value]:
                return values.absolute(value)
            case (("min" | "max"), _):
                return self._extreme("<" if name == "min" else ">", arguments)
            case "len", [table]:
                return len(table)
        function = self._text.constants.get(name)
        if function is None or not callable(function):
            raise Refused(f"a call of {name}")
        if all(known(x) for x in arguments):
            return function(*arguments)
        if name == "sqrt":
            return values.root(arguments[0])
        if not self._width:
            return self._call(function, [values.real(x) for x in arguments])
        spread = [values.spread(values.real(x), self._width) for x in arguments]
        return values.joined([
            self._call(function, [values.element(x, lane) for x in spread])
            for lane in range(self._width)
        ])  # fmt: skip

    def _extreme(self, sign: str, arguments: list[Any]) -> Any:
        found = arguments[0]
        for value in arguments[1:]:
            found = self._values.choose(self._values.compare(sign, value, found), value, found)
        return found

    def _inside(self, function: ast.FunctionDef, arguments: list[Any]) -> Any:
        """Walk a function where it is called."""
        env = dict(zip([one.arg for one in function.args.args], arguments, strict=True))
        frame = Frame()
        self._frames.append(frame)
        left = self._block(function.body, env)
        self._frames.pop()
        if frame.exit is not None:
            builder = self._values.builder
            if not (left and builder.block.is_terminated):
                builder.branch(frame.exit)
            builder.position_at_end(frame.exit)
        return frame.result
