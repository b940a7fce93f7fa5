"""Kernels and driver as plain Python: their own texts, run by the interpreter, none compiled."""

import ast
import contextlib
import math
import re
import threading
from functools import cache
from unittest.mock import MagicMock

import numpy as np
from numba.core import event

from symsimpson.program.driver import driver_text
from symsimpson.program.numbers import Kernels, Numbers
from symsimpson.targets.binding import bind
from symsimpson.text.interface import MATH
from symsimpson.text.syntax import definitions, outline, redefined

#: Kernels by their address, which is none of the machine.
_kernels = [None]
#: Syntax trees are made in one thread at a time: Python 3.11 counts their depth for all together.
_parsing = threading.Lock()


def total(function):
    """Return a value where there is no real one, as compiled code does."""

    def evaluated(*arguments):
        try:
            value = function(*arguments)
        except ValueError:
            return math.nan
        except OverflowError:
            return math.inf
        return math.nan if isinstance(value, complex) else value

    return evaluated


def divided(a, b):
    if b:
        return a / b
    return math.copysign(math.inf, b) * a if a else math.nan


@total
def raised(a, b):
    return a**b if a or b >= 0 else math.inf


FUNCTIONS = {name: getattr(math, name) for name in (*MATH, "atan2")}
QUICK = {
    **FUNCTIONS,
    "pi": math.pi,
    "real": float,
    "array": lambda rows: rows,
    "compiled": lambda function: function,
    "carray": lambda workspace, shape: workspace,
}
#: What has a value everywhere, at three times the time.
TOTAL = {
    **QUICK,
    **{name: total(function) for name, function in FUNCTIONS.items()},
    "divided": divided,
    "raised": raised,
}


class _Lists(ast.NodeTransformer):
    """Writes W[row, lane] as W[lane][row], TABLE[i, j] as TABLE[i][j], and places as numbers."""

    def __init__(self, places):
        self.places = places

    def visit_Subscript(self, node):
        self.generic_visit(node)
        if not isinstance(node.slice, ast.Tuple):
            return node
        first, second = node.slice.elts
        if getattr(node.value, "id", "") == "W":
            first, second = second, first
        outer = ast.copy_location(ast.Subscript(node.value, first, ast.Load()), node)
        return ast.copy_location(ast.Subscript(outer, second, node.ctx), node)

    def visit_Name(self, node):
        found = self.places.get(node.id) if isinstance(node.ctx, ast.Load) else None
        return node if found is None else ast.copy_location(ast.Constant(found), node)


@cache
def _bound(text, name, arithmetic):
    """Return a function of a module whose workspace is a list of columns."""
    with _parsing:
        return getattr(_bind(text, name, TOTAL if arithmetic == "total" else QUICK), name)


def _bind(text, name, arithmetic):
    needed = ast.parse(_needed(text, name))
    places = {
        node.targets[0].id: node.value.value
        for node in outline(text).body
        if isinstance(node, ast.Assign) and type(getattr(node.value, "value", None)) is int
    }
    return bind(_Lists(places).visit(needed), arithmetic)


def _needed(text, name):
    """Return the constants of a module, and of its functions those that one calls: one of ten."""
    lines, spans = text.splitlines(), definitions(text)
    functions = {
        node.name: "\n".join(lines[slice(*spans[node.name])])
        for node in outline(text).body
        if isinstance(node, ast.FunctionDef)
    }
    tables = {x.id for node in outline(text).body for x in ast.walk(node) if type(x) is ast.Name}
    found, waiting = set(), {name, *functions.keys() & tables}
    while waiting:
        one = waiting.pop()
        found.add(one)
        waiting |= functions.keys() & set(re.findall(r"\w+", functions[one])) - found
    leave = {other: "" for other in functions if other not in found}
    return redefined(text, leave)


def call(address, h, t, W):
    """Call a kernel at an address, with a workspace of NumPy."""
    text, name = _kernels[address]
    columns = W.T.tolist()
    try:
        _bound(text, name, "quick")(float(h), float(t), columns)
        W.T[:] = columns
    except (ArithmeticError, ValueError, TypeError):  # somewhere there is no real value
        columns = W.T.tolist()
        _bound(text, name, "total")(float(h), float(t), columns)
        W.T[:] = columns


@cache
def _driver(text):
    own = {"njit": lambda **options: lambda function: function, "types": MagicMock()}
    return bind(text, {**TOTAL, **own, "call": call, "np": np})


class PlainKernels(Kernels):
    """Addresses of kernels that Python runs."""

    def _addresses(self, text, label, names):
        found = []
        for name in names:
            if name:
                _kernels.append((text, name))
            found.append(len(_kernels) - 1 if name else 0)
        return found


class Plain(Numbers):
    """Double precision without a compiler: about 0.1 ms for a step of a double pendulum."""

    def __reduce__(self):
        return "PLAIN"

    def kernels(self, text, header, lanes=1):
        return PlainKernels(text, header, lanes)

    def driver(self, name, lanes=1, *, renewing=False, iterated=True):
        text = driver_text(lanes, renewing=renewing, iterated=iterated)
        function = getattr(_driver(text), name)

        def quiet(*arguments):
            with np.errstate(all="ignore"):
                return function(*arguments)

        return quiet


PLAIN = Plain()


class _Refusing(event.Listener):
    """Refuses to compile."""

    def on_start(self, event):
        raise AssertionError("a test outside tests/compiled is fast and compiles nothing")

    def on_end(self, event):
        """Let it end."""


@contextlib.contextmanager
def plain(monkeypatch):
    """Run kernels of steppers that are made meanwhile in Python, and refuse to compile."""
    monkeypatch.setattr("symsimpson.program.program.FLOAT64", PLAIN)
    with event.install_listener("numba:compiler_lock", _Refusing()):
        yield
