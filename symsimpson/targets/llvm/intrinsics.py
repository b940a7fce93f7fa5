"""Kernels as numba intrinsics, which use the LLVM module, options and cache of numba."""

from __future__ import annotations

import ast
import hashlib
from collections.abc import Callable
from functools import cache, lru_cache
from importlib import resources
from typing import Any

from llvmlite import ir

from symsimpson.errors import GenerationError
from symsimpson.targets.llvm.control_flow import Calls
from symsimpson.targets.llvm.memory import Array, BlockBuilder
from symsimpson.targets.llvm.trees import ARGUMENTS, Text, read_text
from symsimpson.targets.llvm.values import DOUBLE, INT, UnsupportedConstruct
from symsimpson.targets.llvm.walker import Walker

#: Loops of the driver with at most this many operations in all turns are unrolled.
FEW = 16
#: LLVM attributes of functions that are called rarely. LLVM does not unroll their loops, and needs
#: a fifth of the time.
SMALL = ("noinline", "minsize", "optsize")


@lru_cache(maxsize=4)  # the functions of a text are compiled one after the other
def read_functions(text: str) -> Text:
    """Read the decorated functions of a text; the text is executed for its constants."""
    functions = {
        node.name: node
        for node in ast.parse(text).body
        if isinstance(node, ast.FunctionDef) and node.decorator_list
    }
    constants: dict[str, Any] = {}
    exec(compile(text, "<functions for numba>", "exec"), constants)
    return Text(functions, constants)


def function_intrinsic(text: Callable[[], Text], name: str, signature: Any, bits: int) -> Any:
    """Return the intrinsic that a stub calls; the walker emits the code of the function ``name``.

    ``text()`` returns the functions, and is called only during compilation. ``bits`` is the largest
    width of vectors.
    """
    from numba import types

    def code(context: Any, builder: Any, called: Any, arguments: list[Any]) -> Any:
        # without fused products, times equal those that Python computes
        values = Calls(builder, ())
        set.add(builder.function.attributes, vector_attributes(bits))
        whole = text()
        # functions that each step calls are inlined
        apart = {
            k: SMALL if "RARE" in _options(node) else ()
            for k, node in whole.functions.items()
            if "INLINE" not in _options(node)
        }
        for attribute in apart[name]:
            builder.function.attributes.add(attribute)
        pairs = zip(called.args, arguments, strict=True)
        given = [_argument(context, values, kind, argument) for kind, argument in pairs]
        return_value = Walker(whole, values, library_caller(context), FEW, apart).function(
            name, given
        )
        if called.return_type == types.void:
            return context.get_dummy_value()
        result = called.return_type
        return values.bit(return_value) if result == types.boolean else values.whole(return_value)

    return make_intrinsic(signature, code)


def _options(node: ast.FunctionDef) -> str:
    return ast.unparse(node.decorator_list[0]) if node.decorator_list else ""


def _argument(context: Any, values: Calls, kind: Any, value: Any) -> Any:
    """Convert an argument of numba to a number, an array, or a list for a tuple."""
    from numba import types

    if isinstance(kind, types.BaseTuple):
        parts: Any = kind
        return [
            _argument(context, values, part, values.builder.extract_value(value, k))
            for k, part in enumerate(parts.types)
        ]
    return _array(context, values, kind, value) if isinstance(kind, types.Array) else value


def _array(context: Any, values: Calls, kind: Any, value: Any) -> Array:
    """Convert an array of numba to an array of the walker."""
    builder = values.builder
    array = context.make_array(kind)(context, builder, value)
    shape = tuple(builder.extract_value(array.shape, k) for k in range(kind.ndim))
    if kind.layout == "C":
        return values.contiguous(array.data, shape)
    size = ir.Constant(INT, kind.dtype.bitwidth // 8)
    strides = (builder.extract_value(array.strides, k) for k in range(kind.ndim))
    return Array(array.data, shape, tuple(builder.sdiv(stride, size) for stride in strides))


@cache
def walker_digest() -> str:
    """Return the SHA-256 digest of the files of this package: changes invalidate cached code."""
    files = sorted(resources.files("symsimpson.targets.llvm").iterdir(), key=lambda file: file.name)
    content = b"".join(file.read_bytes() for file in files if file.name.endswith(".py"))
    return hashlib.sha256(content).hexdigest()


def stub(name: str, count: int) -> str:
    """Return the text of a function with ``count`` arguments that calls ``walk_<name>``."""
    names = _names(count)
    return f"def {name}({names}):\n    return walk_{name}({names})\n"


def stubs(text: str, names: list[str]) -> str:
    """Return a text with stubs that replace kernels, with the same signature and options."""
    lines = [line for line in text.splitlines() if line.startswith(("SIGNATURE =", "OPTIONS ="))]
    return "\n\n".join(["\n".join(lines), *(stub(name, len(ARGUMENTS)) for name in names)])


def make_intrinsic(signature: Any, code: Callable[..., Any]) -> Any:
    """Return a numba intrinsic with this signature, whose instructions ``code`` emits."""
    from numba.extending import intrinsic

    namespace: dict[str, Any] = {"signature": signature, "code": code}
    names = _names(len(signature.args))
    exec(f"def walked(typing_context, {names}): return signature, code", namespace)
    return intrinsic(namespace["walked"])


def _names(count: int) -> str:
    return ", ".join(f"a{k}" for k in range(count))


def kernel_intrinsic(text: str, name: str, lanes: int, bits: int) -> Any:
    """Return a numba intrinsic for a kernel; the walker emits its code during compilation.

    ``text`` is the module, and ``bits`` is the largest width of vectors.
    """
    from numba import types

    def code(context: Any, builder: Any, signature: Any, arguments: list[Any]) -> Any:
        set.add(builder.function.attributes, vector_attributes(bits))  # it is inlined there
        callee = build_kernel(context, builder.module, read_text(text), name, lanes, bits)
        builder.call(callee, arguments)
        return context.get_dummy_value()

    pointer: Any = types.CPointer  # which has no types of its own
    signature = types.void(types.float64, types.float64, pointer(types.float64))
    return make_intrinsic(signature, code)


def build_kernel(
    context: Any, module: ir.Module, text: Text, name: str, lanes: int, bits: int
) -> ir.Function:
    """Add a kernel to an LLVM module, with lanes or nodes as vectors if possible."""
    alone: frozenset[str] = frozenset()
    while True:
        try:
            return _walk_kernel(context, module, text, name, lanes, bits, at_once=True, alone=alone)
        except UnsupportedConstruct as refused:  # lanes take different branches
            if lanes == 1 or refused.function in {"", name, *alone}:
                break
            alone |= {refused.function}
    return _walk_kernel(context, module, text, name, lanes, bits, at_once=False)


def library_caller(context: Any) -> Callable[[Any, Any, list[Any]], Any]:
    """Return a function that emits calls of functions of ``math`` like numba does."""
    from numba import types

    def call(builder: ir.IRBuilder, function: Any, arguments: list[Any]) -> Any:
        kind = context.typing_context.resolve_value_type(function)
        numbers = [types.float64] * len(arguments)
        signature = kind.get_call_type(context.typing_context, numbers, {})
        return context.get_function(kind, signature)(builder, arguments)

    return call


def vector_attributes(bits: int) -> str:
    """Return the LLVM attributes of a function for vectors of this many bits.

    llvmlite does not accept them, so callers add them to its set of attributes directly. LLVM
    splits longer vectors of the text into several registers.
    """
    return f'"prefer-vector-width"="{bits}" "min-legal-vector-width"="0"'


def _walk_kernel(
    context: Any,
    module: ir.Module,
    text: Text,
    name: str,
    lanes: int,
    bits: int,
    *,
    at_once: bool,
    alone: frozenset[str] = frozenset(),
) -> ir.Function:
    kind = ir.FunctionType(ir.VoidType(), [DOUBLE, DOUBLE, DOUBLE.as_pointer()])
    kernel = ir.Function(module, kind, module.get_unique_name(f"walked_{name}"))
    kernel.linkage = "internal"
    kernel.attributes.add("alwaysinline")
    set.add(kernel.attributes, vector_attributes(bits))
    builder = BlockBuilder(kernel.append_basic_block("entry"))
    h, t, workspace = kernel.args

    rows = Array(workspace, (None, lanes), (lanes, 1), values=True)
    walker = Walker(text, Calls(builder), library_caller(context))
    try:
        vector, lane_scratch = at_once and lanes > 1, at_once and lanes == 1
        walker.kernel(name, h, t, rows, vector=vector, lane_scratch=lane_scratch, alone=alone)
    except (UnsupportedConstruct, GenerationError):
        module.globals.pop(kernel.name)
        raise
    builder.ret_void()
    return kernel
