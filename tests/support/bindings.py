"""Modules that are run with numbers of Python."""

import cmath
import math
from types import SimpleNamespace
from typing import Any

from symsimpson.targets.binding import bind, plain_arithmetic
from symsimpson.text.interface import MATH


def bind_float(source: str) -> SimpleNamespace:
    """Bind to Python floats: the same operations as compiled, without a compiler."""
    functions = {name: getattr(math, name) for name in [*MATH, "atan2"]}
    return bind(source, plain_arithmetic(functions, float))


def bind_complex(source: str) -> SimpleNamespace:
    """Bind to complex numbers, for derivatives by a complex step."""
    functions: dict[str, Any] = {
        name: getattr(cmath, name) for name in MATH if hasattr(cmath, name)
    }
    functions["sincos"] = lambda x: (cmath.sin(x), cmath.cos(x))
    return bind(source, plain_arithmetic(functions, float))
