"""Kernels as intrinsics of numba, which gives the module of LLVM, options, machine and cache."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from functools import cache
from importlib import resources
from typing import Any

from llvmlite import ir

from symsimpson.errors import GenerationError
from symsimpson.walk.arrays import Array
from symsimpson.walk.calls import Calls
from symsimpson.walk.rows import BlockBuilder
from symsimpson.walk.text import ARGUMENTS, Text, read_text
from symsimpson.walk.values import DOUBLE, Refused
from symsimpson.walk.walker import Walker

__all__ = ["called_by_stub", "library", "stub", "stubs", "walker_digest", "walking", "wide"]


@cache
def walker_digest() -> str:
    """Return a digest of the files of this package, which may make other code of the same text."""
    files = sorted(resources.files("symsimpson.walk").iterdir(), key=lambda file: file.name)
    content = b"".join(file.read_bytes() for file in files if file.name.endswith(".py"))
    return hashlib.sha256(content).hexdigest()


def stub(name: str, count: int) -> str:
    """Return the text of a function with so many arguments that calls ``walk_<name>``."""
    names = _names(count)
    return f"def {name}({names}):\n    return walk_{name}({names})\n"


def stubs(text: str, names: list[str]) -> str:
    """Return a text with functions to compile in place of kernels, for the same signature."""
    lines = [line for line in text.splitlines() if line.startswith(("SIGNATURE =", "OPTIONS ="))]
    return "\n\n".join(["\n".join(lines), *(stub(name, len(ARGUMENTS)) for name in names)])


def called_by_stub(signature: Any, code: Callable[..., Any]) -> Any:
    """Return an intrinsic of numba with this signature and this generator of instructions."""
    from numba.extending import intrinsic

    namespace: dict[str, Any] = {"signature": signature, "code": code}
    names = _names(len(signature.args))
    exec(f"def walked(typing_context, {names}): return signature, code", namespace)
    return intrinsic(namespace["walked"])


def _names(count: int) -> str:
    return ", ".join(f"a{k}" for k in range(count))


def walking(text: str, name: str, lanes: int, bits: int) -> Any:
    """Return an intrinsic of numba whose instructions are made of a kernel when it is compiled.

    ``text`` is the module, and ``bits`` says how wide vectors may be.
    """
    from numba import types

    def code(context: Any, builder: Any, signature: Any, arguments: list[Any]) -> Any:
        set.add(builder.function.attributes, wide(bits))  # it is inlined there
        callee = function(context, builder.module, read_text(text), name, lanes, bits)
        builder.call(callee, arguments)
        return context.get_dummy_value()

    pointer: Any = types.CPointer  # which has no types of its own
    signature = types.void(types.float64, types.float64, pointer(types.float64))
    return called_by_stub(signature, code)


def function(
    context: Any, module: ir.Module, text: Text, name: str, lanes: int, bits: int
) -> ir.Function:
    """Write a kernel into a module of LLVM: lanes, or nodes, as one vector, or one by one."""
    alone: frozenset[str] = frozenset()
    while True:
        try:
            return _walked(context, module, text, name, lanes, bits, at_once=True, alone=alone)
        except Refused as refused:  # lanes that go different ways, in all of it or a part
            if lanes == 1 or refused.function in {"", name, *alone}:
                break
            alone |= {refused.function}
    return _walked(context, module, text, name, lanes, bits, at_once=False)


def library(context: Any) -> Callable[[Any, Any, list[Any]], Any]:
    """Return a function that writes calls of functions of ``math`` as numba does."""
    from numba import types

    def call(builder: ir.IRBuilder, function: Any, arguments: list[Any]) -> Any:
        kind = context.typing_context.resolve_value_type(function)
        numbers = [types.float64] * len(arguments)
        signature = kind.get_call_type(context.typing_context, numbers, {})
        return context.get_function(kind, signature)(builder, arguments)

    return call


def wide(bits: int) -> str:
    """Return attributes of a function by which its vectors may have so many bits.

    llvmlite does not know them: they are added to its set. Longer vectors of the text are taken
    apart: none of them has to be in one register.
    """
    return f'"prefer-vector-width"="{bits}" "min-legal-vector-width"="0"'


def _walked(
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
    set.add(kernel.attributes, wide(bits))
    builder = BlockBuilder(kernel.append_basic_block("entry"))
    h, t, workspace = kernel.args

    rows = Array(workspace, (None, lanes), (lanes, 1), values=True)
    walker = Walker(text, Calls(builder), library(context))
    try:
        vector, lane_scratch = at_once and lanes > 1, at_once and lanes == 1
        walker.kernel(name, h, t, rows, vector=vector, lane_scratch=lane_scratch, alone=alone)
    except (Refused, GenerationError):
        module.globals.pop(kernel.name)
        raise
    builder.ret_void()
    return kernel
