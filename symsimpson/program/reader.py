"""Parser for expressions of the user, texts or SymPy, into Python code of a kernel."""

from __future__ import annotations

import ast
import math
import operator
import re
from collections.abc import Callable
from itertools import chain
from keyword import iskeyword
from typing import Any, NoReturn

from symsimpson.errors import reject
from symsimpson.program.program import Program
from symsimpson.support.names import counted, did_you_mean, spelled
from symsimpson.text.quantity import MULTIPLIERS, QUANTITIES, SCALARS, VECTORS, scalars_of

#: Functions of ``math`` that an expression may contain.
OF_MATH = "acos, asin, atan, atan2, cos, cosh, exp, log, sin, sinh, sqrt, tan, tanh"
#: All functions, with the smallest and the largest number of their arguments.
_FUNCTIONS = dict.fromkeys([*OF_MATH.split(", "), "abs"], (1, 1))
_FUNCTIONS |= {"atan2": (2, 2), "min": (1, 50), "max": (1, 50)}
_SPELLED = {"Abs": "abs", "Min": "min", "Max": "max"}
_SIGNS: dict[type[ast.AST], str] = {
    **{ast.Add: "+", ast.Sub: "-", ast.Mult: "*"},
    **{ast.Div: "/", ast.Pow: "**", ast.Mod: "%"},
}
#: The characters of expressions. Names may contain other characters.
SYNTAX = re.compile(r"[\w\s.+\-*/%(),]*")
OPERATORS = re.compile(r"[.+\-*/%(),]")
#: Symbols of the quantities that the energy kernel computes before it evaluates an expression.
COMPUTED = tuple(
    quantity.symbol
    for quantity in QUANTITIES.values()
    if quantity.symbol and quantity.kernel and quantity is not MULTIPLIERS
)
#: Most characters of a text of the user, and of a text that SymPy writes.
LONGEST, LONGEST_OF_SYMPY = 2000, 100_000
LARGEST = 10**300
#: Operators of equal precedence, which Python evaluates from left to right.
_RANKS: tuple[tuple[type[ast.AST], ...], ...] = ((ast.Add, ast.Sub), (ast.Mult, ast.Div, ast.Mod))
#: Most terms of a sum in one row, because the depth of recursion is the length of a row.
_ROW = 100
#: Operators and functions for constant folding.
_NUMBERS: dict[type[ast.AST] | str, Callable[..., Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Pow: operator.pow,
    ast.Mod: operator.mod,
    ast.USub: operator.neg,
    ast.UAdd: operator.pos,
    **{name: getattr(math, name) for name in _FUNCTIONS if hasattr(math, name)},
    **{"abs": abs, "min": min, "max": max},
}


class ExpressionParser:
    """A parser that translates an expression through its syntax tree, from a list of known nodes.

    Names are names of the user, which need not be identifiers of Python, or names of the module.
    ``energetic`` tells whether the expression contains the energy or velocities, and
    ``with_multipliers`` whether it contains multipliers of constraints. ``rest`` tells whether it
    is a remainder such as ``Mod(q1, 2*pi)``. Every method raises InputError for an invalid
    expression.
    """

    def __init__(self, program: Program, where: str) -> None:
        self._where, self._header = where, program.header
        self.energetic = self.with_multipliers = self.rest = False
        coordinates, parameters = program.names.coordinates, program.names.parameters
        self._known = {"t": "t", "pi": "3.141592653589793"}
        self._known |= {scalar.name: scalar.symbol for scalar in scalars_of(program.header)}
        reserved = set(self._known) - {"pi"}
        self._known |= {a: f"a_{i}" for a, i in parameters.places.items()}
        of_state = {
            f"{vector.prefix}{q}": f"{vector.symbol}{i}"
            for vector in reversed(VECTORS)  # names of coordinates come first
            for q, i in coordinates.places.items()
        }
        self._double = set(parameters.places) & (reserved | (of_state.keys() - coordinates.places))
        self._known |= of_state
        multipliers = zip(
            MULTIPLIERS.shown(program.names), range(len(program.header.constraints)), strict=True
        )
        held = {name: f"{MULTIPLIERS.symbol}{i}" for name, i in multipliers}
        self._known = held | self._known
        momenta = getattr(program.declared, "momenta", ())
        self._known |= {str(p): f"p_{i}" for i, p in enumerate(momenta)}
        self._moving = set(coordinates.places)
        shown = [vector.shown(program.names) for vector in VECTORS]
        self._listed = [*chain(*shown), *parameters.shown]
        self._listed += [*held, "t", *(scalar.name for scalar in scalars_of(program.header)), "pi"]
        self._used: set[str] = set()
        #: Plain identifiers, and the names of the user that they replace in a text.
        self._replaced: dict[str, str] = {}

    def parse(self, expression: Any) -> str:
        """Parse a text, an expression of SymPy, or an equation, which means left minus right."""
        most = LONGEST
        if isinstance(expression, type):  # such as sympy.Function("f"), or a function of SymPy
            self._reject(f"{expression} is a function without arguments: write {expression}(...)")
        if hasattr(expression, "free_symbols") and hasattr(expression, "xreplace"):
            if hasattr(expression, "shape"):
                self._reject("it is a matrix, not one expression")
            expression, most = self._with_plain_symbols(expression), LONGEST_OF_SYMPY
        if hasattr(expression, "lhs") and hasattr(expression, "rhs"):
            left, right = expression.lhs, expression.rhs
            return self.parse_text(f"({left})" if right == 0 else f"({left}) - ({right})", most)
        return self.parse_text(str(expression), most)

    def to_portable(self, expression: Any, text: str) -> str:
        """Return the expression for a file: as given, or with the names of the module.

        ``text`` is the parsed expression. The expression stays as given if the module alone can
        parse it.
        """
        coordinates = [*enumerate(self._header.coordinates)]
        parameters = enumerate(self._header.parameters)
        written = {f"q_{i}": name for i, name in coordinates}
        written |= {f"{kind}_{i}": f"{kind}_{name}" for kind in "pv" for i, name in coordinates}
        written |= {f"a_{i}": name for i, name in parameters}
        held = enumerate(self._header.constraints)
        written |= {f"{MULTIPLIERS.symbol}{i}": f"{MULTIPLIERS.prefix}{x}" for i, x in held}
        known = {"t": "t", "pi": self._known["pi"]}
        known |= {scalar.name: scalar.symbol for scalar in scalars_of(self._header)}
        known |= {name: symbol for symbol, name in written.items()}
        if all(known.get(name) == self._known[name] for name in self._used):
            return str(expression)
        return re.sub(r"\b[qpval]_\d+\b", lambda match: written[match[0]], text)

    def _with_plain_symbols(self, expression: Any) -> Any:
        """Replace symbols, coordinates and velocities of a SymPy expression by plain symbols."""
        import sympy as sp  # the caller has loaded it already
        from sympy.core.function import AppliedUndef

        rules, work, seen = {}, [expression], set()
        while work:
            node = work.pop()
            if node in seen:
                continue
            seen.add(node)
            velocity = (
                isinstance(node, sp.Derivative)
                and isinstance(node.expr, AppliedUndef)
                and node.derivative_count == 1
            )
            if not velocity and not isinstance(node, (sp.Symbol, AppliedUndef)):
                work += node.args
                continue
            name = spelled(node)
            if name not in self._known:  # the text of such a name could mean something else
                self._reject(f"it contains the unknown name {name!r}", name)
            moving = node.expr if velocity else node
            if not isinstance(moving, sp.Symbol) and [*map(type, moving.args)] != [sp.Symbol]:
                self._reject(f"it contains {moving}, which is not a value at the time of a state")
            if not _plain(name) or velocity or isinstance(node, AppliedUndef):
                rules[node] = sp.Symbol(self._stand_in(name))
        return expression.xreplace(rules)

    def _stand_in(self, name: str) -> str:
        """Return a plain identifier that replaces a known name."""
        if _plain(name):
            return name
        for plain, original in self._replaced.items():
            if original == name:
                return plain
        plain = f"symbol_{len(self._replaced)}_"
        while plain in self._known:
            plain += "_"
        self._replaced[plain] = name
        self._known[plain] = self._known[name]
        for names in (self._moving, self._double):
            if name in names:
                names.add(plain)
        return plain

    def _with_stand_ins(self, text: str) -> str:
        """Replace names in a text that are no identifiers, the longest names first."""
        strange = sorted(filter(_needs_replacement, self._known), key=len, reverse=True)
        if not strange:
            return text

        def whole(name: str) -> str:  # a letter at its end must not continue in a longer word
            first, last = (r"\b" if re.match(r"\w", x) else "" for x in (name[0], name[-1]))
            return first + re.escape(name) + last

        pattern = "|".join(map(whole, strange))
        return re.sub(pattern, lambda match: f" {self._stand_in(match[0])} ", text)

    def parse_text(self, text: str, most: int = LONGEST) -> str:
        """Parse a text of at most ``most`` characters."""
        if len(text) > most:
            self._reject(f"it has {len(text)} characters, more than {most}")
        try:
            body = ast.parse(self._with_stand_ins(text).strip(), mode="eval").body
        except (SyntaxError, ValueError, RecursionError, MemoryError):
            self._reject("it is no expression")
        try:
            written = self._write(body)
            _evaluate_constant(ast.parse(written, mode="eval").body)
        except (RecursionError, MemoryError, SyntaxError):  # Python's parser has limits of its own
            self._reject("it is nested too deeply")
        except ArithmeticError as error:
            self._reject(f"{error} in it has no value")
        self.rest = isinstance(body, ast.BinOp) and isinstance(body.op, ast.Mod)
        self.rest |= isinstance(body, ast.Call) and ast.unparse(body.func) == "Mod"
        return written

    def _reject(self, what: str, name: str = "") -> NoReturn:
        """Raise InputError; ``name`` is an unknown name for which the message suggests another."""
        for plain, original in self._replaced.items():
            what = what.replace(plain, original)
        hint = did_you_mean(name, self._listed) if name else ""
        reject(
            f"{what}.{hint}",
            where=self._where,
            remedy=f"Use numbers, + - * / ** %, {', '.join(sorted(_FUNCTIONS))}, Mod, and the "
            f"names {', '.join(self._listed)}.",
        )

    def _write(self, node: ast.expr) -> str:
        match node:
            case ast.Constant(value=bool()):
                self._reject("it contains a truth value")
            case ast.Constant(value=int() | float() as number):
                if not -LARGEST < number < LARGEST:
                    self._reject("it contains a number that is too large")
                return repr(float(number))
            case ast.Name(id=name) if name in self._known:
                if name in self._double:
                    self._reject(f"{name!r} is a parameter, and the name of another quantity, too")
                self._used.add(name)
                self.energetic |= self._known[name].startswith(COMPUTED)
                self.with_multipliers |= self._known[name].startswith(MULTIPLIERS.symbol)
                if self.with_multipliers and {scalar.name for scalar in SCALARS} & self._used:
                    self._reject("it contains both the energy and a multiplier")
                return self._known[name]
            case ast.Call(
                func=ast.Name(id="Derivative"),
                args=[ast.Call(func=ast.Name(id=name), args=[ast.Name(id="t")]), ast.Name(id="t")],
            ) if name in self._moving:
                return self._write(ast.Name(id=f"v_{name}"))  # SymPy's velocity
            case ast.Call(func=ast.Name(id=name), args=[ast.Name(id="t")], keywords=[]) if (
                name in self._moving
            ):
                return self._write(ast.Name(id=name))  # SymPy writes q1(t)
            case ast.Call(func=ast.Name(id=name), args=arguments, keywords=[]) if (
                _SPELLED.get(name, name) in _FUNCTIONS and arguments
            ):
                least, most = _FUNCTIONS[_SPELLED.get(name, name)]
                if not least <= len(arguments) <= most:
                    self._reject(f"{name} cannot take {counted(len(arguments), 'argument')}")
                inner = ", ".join(map(self._write, arguments))
                return f"{_SPELLED.get(name, name)}({inner})"
            case ast.Call(func=ast.Name(id="Mod"), args=[left, right], keywords=[]):
                return self._write(ast.BinOp(left, ast.Mod(), right))
            case ast.Name(id=name):
                self._reject(f"it contains the unknown name {name[:60]!r}", name)
            case ast.UnaryOp(op=op, operand=operand) if isinstance(op, (ast.USub, ast.UAdd)):
                sign = "-" if isinstance(op, ast.USub) else "+"
                return f"({sign}{self._write(operand)})"
            case ast.BinOp(left=left, op=ast.Pow(), right=ast.Constant(value=int() as power)) if (
                abs(power) < 100
            ):
                return f"({self._write(left)} ** {power})"
            case ast.BinOp(left=left, op=ast.Pow(), right=right):
                return f"({self._write(left)} ** {self._write(right)})"
            case ast.BinOp(op=op) if type(op) in _SIGNS:
                return self._write_row(node, next(rank for rank in _RANKS if type(op) in rank))
        self._reject(f"it contains {ast.unparse(node)[:60]!r}, which is not allowed")

    def _write_row(self, node: ast.expr, rank: tuple[type[ast.AST], ...]) -> str:
        """Write a sum or a product without recursion over its terms; long sums become rows."""
        parts: list[tuple[str, str]] = []
        while isinstance(node, ast.BinOp) and type(node.op) in rank:
            parts.append((_SIGNS[type(node.op)], self._write(node.right)))
            node = node.left
        parts.append(("+", self._write(node)))
        parts.reverse()
        length = _ROW if ast.Add in rank else len(parts)
        rows = []
        for first in range(0, len(parts), length):
            (sign, part), *others = parts[first : first + length]
            further = "".join(f" {sign} {part}" for sign, part in others)
            rows.append(f"({'-' if sign == '-' else ''}{part}{further})")
        return rows[0] if len(rows) == 1 else f"({' + '.join(rows)})"


def _evaluate_constant(node: ast.expr) -> Any:
    """Evaluate an expression of numbers; return None if it contains a name.

    Raises ArithmeticError with the text of a part that has no value, such as 1/0.
    """
    key: type[ast.AST] | str
    match node:
        case ast.Constant(value=number):
            return number
        case ast.UnaryOp(op=op, operand=operand):
            key, inner = type(op), [operand]
        case ast.BinOp(left=left, op=op, right=right):
            key, inner = type(op), [left, right]
        case ast.Call(func=ast.Name(id=name), args=inner):
            key = name
        case _:
            return None
    values = [_evaluate_constant(part) for part in inner]
    if None in values:
        return None
    try:
        value = _NUMBERS[key](*values)
    except (ArithmeticError, ValueError):
        value = math.nan
    if isinstance(value, complex) or not math.isfinite(value):
        raise ArithmeticError(ast.unparse(node)[:60])
    return value


def _plain(name: str) -> bool:
    """Return whether a name is an ASCII identifier. Python normalises other letters."""
    return name.isascii() and name.isidentifier() and not iskeyword(name)


def _needs_replacement(name: str) -> bool:
    """Return whether a name is no plain identifier, but can be recognised in a text."""
    if _plain(name) or not name.strip():
        return False
    if not SYNTAX.fullmatch(name) or iskeyword(name):
        return True
    if OPERATORS.search(name):
        return False
    try:
        ast.parse(name.strip(), mode="eval")
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        return True
    return name.isidentifier()
