"""Functions of numbers and arrays that are walked, where numba calls them by its own types."""

from __future__ import annotations

import ast
from collections.abc import Callable
from functools import lru_cache
from typing import Any

from llvmlite import ir

from symsimpson.walk.arrays import Array
from symsimpson.walk.calls import Calls
from symsimpson.walk.kernels import called_by_stub, library, wide
from symsimpson.walk.text import Text
from symsimpson.walk.values import INT
from symsimpson.walk.walker import Walker

#: Loops of fewer operations in all are no loops.
FEW = 16
#: Functions that are called rarely are made small: LLVM unrolls none of their loops, which takes it
#: a fifth of the time.
SMALL = ("noinline", "minsize", "optsize")

__all__ = ["read_functions", "walking_function"]


@lru_cache(maxsize=4)  # functions of a text are made one after the other
def read_functions(text: str) -> Text:
    """Read a text of functions for numba, which is executed for its constants."""
    functions = {
        node.name: node
        for node in ast.parse(text).body
        if isinstance(node, ast.FunctionDef) and node.decorator_list
    }
    constants: dict[str, Any] = {}
    exec(compile(text, "<functions for numba>", "exec"), constants)
    return Text(functions, constants)


def walking_function(text: Callable[[], Text], name: str, signature: Any, bits: int) -> Any:
    """Return what a stub calls: its code is that of a function, walked when it is compiled.

    ``text`` gives the functions, and is called when something is compiled; ``bits`` says how wide
    vectors may be.
    """
    from numba import types

    def code(context: Any, builder: Any, called: Any, arguments: list[Any]) -> Any:
        # no fused products: times are what Python makes of the same steps
        values = Calls(builder, ())
        set.add(builder.function.attributes, wide(bits))
        whole = text()
        # what is called in each step stands in the loop
        apart = {
            k: SMALL if "RARE" in _options(node) else ()
            for k, node in whole.functions.items()
            if "INLINE" not in _options(node)
        }
        for attribute in apart[name]:
            builder.function.attributes.add(attribute)
        pairs = zip(called.args, arguments, strict=True)
        given = [_argument(context, values, kind, argument) for kind, argument in pairs]
        return_value = Walker(whole, values, library(context), FEW, apart).function(name, given)
        if called.return_type == types.void:
            return context.get_dummy_value()
        result = called.return_type
        return values.bit(return_value) if result == types.boolean else values.whole(return_value)

    return called_by_stub(signature, code)


def _options(node: ast.FunctionDef) -> str:
    return ast.unparse(node.decorator_list[0]) if node.decorator_list else ""


def _argument(context: Any, values: Calls, kind: Any, value: Any) -> Any:
    """Return an argument of numba's: a number, an array, or a list of what stands in a tuple."""
    from numba import types

    if isinstance(kind, types.BaseTuple):
        parts: Any = kind
        return [
            _argument(context, values, part, values.builder.extract_value(value, k))
            for k, part in enumerate(parts.types)
        ]
    return _array(context, values, kind, value) if isinstance(kind, types.Array) else value


def _array(context: Any, values: Calls, kind: Any, value: Any) -> Array:
    """Return an array of numba's."""
    builder = values.builder
    array = context.make_array(kind)(context, builder, value)
    shape = tuple(builder.extract_value(array.shape, k) for k in range(kind.ndim))
    if kind.layout == "C":
        return values.contiguous(array.data, shape)
    size = ir.Constant(INT, kind.dtype.bitwidth // 8)
    strides = (builder.extract_value(array.strides, k) for k in range(kind.ndim))
    return Array(array.data, shape, tuple(builder.sdiv(stride, size) for stride in strides))
