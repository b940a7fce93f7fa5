"""Kernels and driver as plain Python: their own texts, run by the interpreter, none compiled."""

import ast
import contextlib
import math
from unittest.mock import MagicMock

import numpy as np
from numba.core import event

from symsimpson.binding import MATH, bind
from symsimpson.runtime.driver.compiled import driver_text
from symsimpson.runtime.kernels.compiled import Kernels
from symsimpson.runtime.kernels.numbers import Numbers

#: Kernels by their address, which is none of the machine.
_functions = [None]
_texts = {}


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


COMMON = {
    **{name: total(getattr(math, name)) for name in (*MATH, "atan2")},
    "pi": math.pi,
    "compiled": lambda function: function,
}
KERNELS = {
    **COMMON, "array": lambda rows: rows, "real": float, "divided": divided, "raised": raised,
    "carray": lambda workspace, shape: workspace,
}  # fmt: skip


class _Lists(ast.NodeTransformer):
    """Writes W[row, lane] as W[lane][row] and TABLE[i, j] as TABLE[i][j]."""

    def visit_Subscript(self, node):
        self.generic_visit(node)
        if not isinstance(node.slice, ast.Tuple):
            return node
        first, second = node.slice.elts
        if getattr(node.value, "id", "") == "W":
            first, second = second, first
        outer = ast.Subscript(node.value, first, ast.Load())
        return ast.Subscript(outer, second, node.ctx)


def _bound(text):
    """Return a module whose workspace is a list of columns."""
    if text not in _texts:
        tree = ast.fix_missing_locations(_Lists().visit(ast.parse(text)))
        _texts[text] = bind(ast.unparse(tree), KERNELS)
    return _texts[text]


def call(address, h, t, W):
    """Call a kernel at an address, with a workspace of NumPy."""
    columns = W.T.tolist()
    _functions[address](float(h), float(t), columns)
    W.T[:] = columns


class PlainKernels(Kernels):
    """Addresses of kernels that Python runs."""

    def _addresses(self, text, label, names):
        module, found = _bound(text), []
        for name in names:
            if name:
                _functions.append(getattr(module, name))
            found.append(len(_functions) - 1 if name else 0)
        return found


class Plain(Numbers):
    """Double precision without a compiler: about 0.4 ms for a step of a double pendulum."""

    def __reduce__(self):
        return "PLAIN"

    def kernels(self, text, header, lanes=1):
        return PlainKernels(text, header, lanes)

    def driver(self, name, lanes=1, *, renewing=False, iterated=True):
        text = driver_text(lanes, renewing=renewing, iterated=iterated)
        if text not in _texts:
            own = {"njit": lambda **options: lambda function: function, "types": MagicMock()}
            _texts[text] = bind(text, {**COMMON, **own, "call": call, "np": np})
        function = getattr(_texts[text], name)

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
    for module in ("api", "runtime.evaluator"):
        monkeypatch.setattr(f"symsimpson.{module}.FLOAT64", PLAIN)
    with event.install_listener("numba:compiler_lock", _Refusing()):
        yield
