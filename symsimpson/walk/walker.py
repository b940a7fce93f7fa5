"""The walker: it goes through the syntax tree of a kernel and does with values what stands there.

Functions are walked where they are called. What is known while walking is computed at once: entries
of tables, rows, conditions on them. Short loops over constants are walked again and again; long
ones, and those whose ends are not known, stay loops. A loop over neighbouring rows, whose turns do
not depend on each other, is walked once, with vectors.
"""

from __future__ import annotations

import ast
import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from symsimpson.errors import GenerationError
from symsimpson.walk.arrays import BYTE, Array, Range
from symsimpson.walk.blocks import Loop, Slot
from symsimpson.walk.calls import Calls
from symsimpson.walk.text import Text
from symsimpson.walk.trees import assigned, leaves, reads_rows, vectors, weight
from symsimpson.walk.values import DOUBLE, INT, KNOWN, Along, Refused, known

__all__ = ["Walker"]

#: A loop over constants with fewer operations in all its turns is walked turn by turn.
FEW = 400
#: As many turns are made to one vector.
WIDTHS = (4, 8, 16)

Env = dict[str, Any]
#: Numbers of arrays that a function makes for itself.
KINDS = {"np.float64": DOUBLE, "np.int64": INT, "np.bool_": BYTE}
COMPARED = {ast.Lt: "<", ast.LtE: "<=", ast.Gt: ">", ast.GtE: ">=", ast.Eq: "==", ast.NotEq: "!="}


class Frame:
    """A function that is being walked: where it is left to, with what, and its loops."""

    def __init__(self) -> None:
        self.exit: Any = None
        self.depth = 0
        self.result: Any = None
        self.slots: Any = None
        self.loops: list[Loop] = []
        self.freed: list[Any] = []


class Walker:
    """Walks functions of a text.

    Parameters
    ----------
    text : Text
    values : Calls
    call : callable
        Makes a call, with a builder, of a function of ``math`` with values that are no vectors.
    few : int
        Loops of fewer operations in all are no loops.
    apart : frozenset of str
        Functions that stay functions, where they are called with the same kinds of values.
    """

    def __init__(
        self, text: Text, values: Calls, call: Callable[[Any, Any, list[Any]], Any], few: int = FEW,
        apart: frozenset[str] = frozenset(),
    ) -> None:  # fmt: skip
        self._text, self._values, self._call, self._few = text, values, call, few
        self._apart, self._made = apart, dict[Any, Any]()
        self._width = 0
        self._frames: list[Frame] = []

    def kernel(self, name: str, h: Any, t: Any, workspace: Array, *, vector: bool) -> None:
        """Walk a kernel for all lanes, as one vector if that is wanted.

        Raises
        ------
        GenerationError
            If the text has something that no kernel has, with the line.
        Refused
            If lanes cannot be one vector.
        """
        lanes = workspace.shape[1]
        env: Env = {"h": h, "t": t, "LANES": lanes}
        self._frames.append(Frame())
        for statement in self._text.functions[name].body:
            match statement:
                case ast.Assign(targets=[ast.Name(id="W")]):
                    env["W"] = workspace
                case ast.For(target=ast.Name(id="lane")) if vector:
                    self._width = lanes
                    env["lane"] = Along(0)
                    self._block(statement.body, env)
                    self._width = 0
                case _:
                    self._statement(statement, env)
        self._frames.pop()

    def function(self, name: str, arguments: list[Any]) -> Any:
        """Walk a function, and return its result.

        Raises
        ------
        GenerationError
            If the text has something that is not known, with the line.
        """
        return self._inside(self._text.functions[name], arguments)

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
            case ast.While(test=test, body=body, orelse=[]):
                self._while(test, body, env)
            case ast.Break() | ast.Continue():
                loop = self._frames[-1].loops[-1]
                broken = isinstance(node, ast.Break)
                self._values.builder.branch(loop.after if broken else loop.following)
                return True
            case ast.Return(value=value):
                return self._leave(None if value is None else self._value(value, env))
            case _:
                raise Refused(f"a statement of type {type(node).__name__}")
        return False

    def _leave(self, result: Any) -> bool:
        """Leave a function, from a branch or a loop by way of a block and variables."""
        frame, values = self._frames[-1], self._values
        if not frame.depth and frame.exit is None:
            frame.result = result
            return True
        if result is not None:
            results = result if isinstance(result, list) else [result]
            if frame.slots is None:
                frame.slots = [values.slot(one, self._width) for one in results]
                frame.result = frame.slots if isinstance(result, list) else frame.slots[0]
            for slot, one in zip(frame.slots, results, strict=True):
                values.write(slot, one)
        frame.exit = frame.exit or values.new_block("left")
        values.builder.branch(frame.exit)
        return True

    def _assign(self, target: ast.expr, value: Any, env: Env) -> None:
        self._put(target, self._places(target, env), value, env)

    def _places(self, target: ast.expr, env: Env) -> Any:
        """Return an array and places in it; None for a name."""
        match target:
            case ast.Name():
                return None
            case ast.Subscript(value=value, slice=ast.Tuple(elts=places)):
                return self._value(value, env), [self._place(x, env) for x in places]
            case ast.Subscript(value=value, slice=place):
                return self._value(value, env), [self._place(place, env)]
        raise Refused("an assignment to something else")

    def _place(self, node: ast.expr, env: Env) -> Any:
        match node:
            case ast.Slice(lower=lower, upper=upper, step=None):
                first = 0 if lower is None else self._value(lower, env)
                return Range(first, None if upper is None else self._value(upper, env))
        return self._value(node, env)

    def _read(self, place: Any) -> Any:
        """Return what stands in an array, a table or a list."""
        source, places = place
        if isinstance(source, Array):
            return self._values.load(source, places, self._width)
        if isinstance(source, list):
            return source[places[0]]
        return self._values.entry(source, places)

    def _at(self, target: Any, place: Any, env: Env) -> Any:
        return self._named(target.id, env) if place is None else self._read(place)

    def _put(self, target: Any, place: Any, value: Any, env: Env) -> None:
        if place is not None:
            if not isinstance(place[0], Array):
                raise Refused("an assignment into something else")
            self._values.store(place[0], place[1], value, self._width)
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
            if not turns:
                return
            if step == 1 and self._as_vector(node, name, turns, env):
                return
            few = len(turns) == 1 or len(turns) * self._weight(node.body, env) <= self._few
            if few and not leaves(node):
                for number in turns:
                    env[name] = number
                    if self._block(node.body, env):
                        raise Refused("a loop that is left")
                return
        self._keep(node, name, (first, end, step), env)

    def _keep(self, node: ast.For, name: str, ends: Any, env: Env) -> None:
        """Walk a loop that stays one."""
        self._let_change(assigned(node.body) - {name}, env)
        own = dict(env)

        def body(number: Any, loop: Loop) -> bool:
            return self._turn(node.body, own | {name: number}, loop)

        self._values.loop(ends, body)
        env.pop(name, None)

    def _while(self, test: ast.expr, statements: Any, env: Env) -> None:
        self._let_change(assigned(statements), env)
        own = dict(env)

        def body(loop: Loop) -> bool:
            return self._turn(statements, dict(own), loop)

        self._values.repeat(lambda: self._value(test, dict(own)), body)

    def _turn(self, statements: Any, env: Env, loop: Loop) -> bool:
        """Walk one turn of a loop; returns whether it ends elsewhere."""
        frame = self._frames[-1]
        frame.depth += 1
        frame.loops.append(loop)
        left = self._block(statements, env)
        frame.loops.pop()
        frame.depth -= 1
        return left

    def _as_vector(self, node: ast.For, name: str, turns: range, env: Env) -> bool:
        """Walk a loop with vectors, if its turns go along neighbouring rows and are independent."""
        if self._width or len(turns) not in WIDTHS or not self._single(env):
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

    @staticmethod
    def _single(env: Env) -> bool:
        """Return whether rows of the workspace stand beside each other."""
        workspace = env.get("W")
        return isinstance(workspace, Array) and workspace.strides == (1, 1)

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
            case ast.Subscript():
                return self._read(self._places(node, env))
            case ast.Attribute(value=ast.Name(id="np"), attr=name):
                return getattr(np, name)
            case ast.Attribute(value=value, attr="shape"):
                return list(self._array(value, env).shape)
            case ast.Attribute(value=value, attr="size"):
                return self._array(value, env).size
            case ast.Compare(left=left, ops=[ast.In()], comparators=[ast.Tuple(elts=parts)]):
                a, found = self._value(left, env), False
                for part in parts:
                    found = values.either(found, values.compare("==", a, self._value(part, env)))
                return found
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
                return self._called(name, [self._value(x, env) for x in arguments])
            case ast.Call(func=ast.Attribute(value=ast.Name(id="np"), attr=name), args=arguments):
                kind = next((ast.unparse(word.value) for word in node.keywords), "np.float64")
                return self._numpy(name, kind, [self._value(x, env) for x in arguments])
            case ast.Call(func=ast.Attribute(value=value, attr=name), args=arguments):
                given = [self._value(x, env) for x in arguments]
                return self._method(self._array(value, env), name, given)
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
            case ast.Pow() if isinstance(b, int):
                return values.power(a, b)
            case ast.Pow():
                return self._library(math.pow, [a, b])
            case ast.BitAnd():
                return values.both(a, b)
            case ast.BitOr():
                return values.either(a, b)
            case ast.FloorDiv():
                return values.quotient(a, b)
            case ast.Mod():
                return values.rest(a, b)
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

    def _called(self, name: str, arguments: list[Any]) -> Any:
        values = self._values
        if name in self._text.functions:
            walk = self._outside if name in self._apart else self._inside
            return walk(self._text.functions[name], arguments)
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
                return table.size if isinstance(table, Array) else len(table)
            case "call", [address, h, t, Array(pointer=workspace)]:
                return values.call_at(address, [values.real(h), values.real(t), workspace])
        function = self._text.constants.get(name)
        original = getattr(getattr(function, "py_func", None), "__name__", None)
        if original in self._text.functions:  # another name of a function
            return self._called(str(original), arguments)
        if function is None or not callable(function):
            raise Refused(f"a call of {name}")
        if all(known(x) for x in arguments):
            return function(*arguments)
        return values.root(arguments[0]) if name == "sqrt" else self._library(function, arguments)

    def _library(self, function: Any, arguments: list[Any]) -> Any:
        """Call a function of ``math``, lane by lane."""
        values = self._values
        if not self._width:
            return self._call(self._values.builder, function, [values.real(x) for x in arguments])
        spread = [values.spread(values.real(x), self._width) for x in arguments]
        return values.joined([
            self._call(self._values.builder, function, [values.element(x, lane) for x in spread])
            for lane in range(self._width)
        ])  # fmt: skip

    def _array(self, node: ast.expr, env: Env) -> Array:
        found = self._value(node, env)
        if not isinstance(found, Array):
            raise Refused("something else where an array is wanted")
        return found

    def _numpy(self, name: str, kind: str, arguments: list[Any]) -> Any:
        """Call a function of numpy."""
        values = self._values
        match name, arguments:
            case (("zeros" | "empty" | "full"), [shape, *rest]):
                sizes = shape if isinstance(shape, list) else [shape]
                value = rest[0] if rest else None if name == "empty" else 0
                return values.room(KINDS[kind], sizes, value, self._frames[-1].freed)
            case "sqrt", [value]:
                return values.root(value)
            case "isnan", [value]:
                return values.compare("!=", value, value)
            case "log", [value]:
                return self._library(math.log, [value])
            case "int64", [value]:
                return values.cut(value)
        raise Refused(f"a call of np.{name}")

    def _method(self, array: Array, name: str, arguments: list[Any]) -> Any:
        """Call a method of an array of one axis."""
        values = self._values
        match name, arguments:
            case "copy", []:
                freed = self._frames[-1].freed
                made = values.room(array.pointer.type.pointee, [array.size], None, freed)
                values.each(
                    array.size, lambda k: values.store(made, [k], values.load(array, [k], 0), 0)
                )
                return made
            case "reshape", [1, -1]:
                return Array(array.pointer, (1, array.size), (array.size, *array.strides))
        raise Refused(f"a call of .{name}")

    def _extreme(self, sign: str, arguments: list[Any]) -> Any:
        found = arguments[0]
        for value in arguments[1:]:
            found = self._values.choose(self._values.compare(sign, value, found), value, found)
        return found

    def _outside(self, function: ast.FunctionDef, arguments: list[Any]) -> Any:
        """Walk a function by itself, once for each kind of its arguments, and call it."""
        values = self._values
        key, given = values.packed(function.name, arguments)
        if key not in self._made:
            self._made[key] = values.apart(
                function.name, given, lambda own: self._inside(function, values.unpacked(key, own))
            )
        made, results = self._made[key]
        return values.call_apart(made, given, results)

    def _inside(self, function: ast.FunctionDef, arguments: list[Any]) -> Any:
        """Walk a function where it is called."""
        env = dict(zip([one.arg for one in function.args.args], arguments, strict=True))
        frame, values = Frame(), self._values
        self._frames.append(frame)
        left = self._block(function.body, env)
        self._frames.pop()
        if frame.exit is not None:
            builder = values.builder
            if not (left and builder.block.is_terminated):
                builder.branch(frame.exit)
            builder.position_at_end(frame.exit)
        values.release(frame.freed)
        if isinstance(frame.result, list):
            return [values.read(x) if isinstance(x, Slot) else x for x in frame.result]
        return values.read(frame.result) if isinstance(frame.result, Slot) else frame.result
