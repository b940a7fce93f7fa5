"""Write a lowered module as the text of a Python file that people can read."""

from __future__ import annotations

import ast
import hashlib
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence, Set
from decimal import Context, Decimal
from itertools import groupby
from typing import Any

import sympy as sp

from symsimpson.discrete.equations import DiscreteEquations
from symsimpson.lower import ir
from symsimpson.lower.expression import Expressions
from symsimpson.lower.heading import banner, docstring, folded, thresholds
from symsimpson.lower.ir import Function, Kernel, Load, Module, Statement, Store
from symsimpson.lower.printer import NAMED_CONSTANTS, Printer, count_operations
from symsimpson.lower.specialise import called
from symsimpson.text.interface import INTERFACE, MATH, OPTIONS, SIGNATURE
from symsimpson.text.library import library_sources

#: Moves that stand on a line of this width; the compiler takes more of them apart slowly.
ON_A_LINE, WIDTH = 3, 100
#: Lists of more integers than this are arrays.
_LONG = 16
#: Fractions with larger denominators are finite decimals.
_LARGE = 10**6
_WORD = re.compile(r"\w+")
#: What stands over groups of functions.
_STEP = "The step: kernels that a run calls."
_OF_SYSTEM = "The system: functions that kernels call."
_SHARED = "Loops and solvers: the same text in all modules."


def emit(equations: DiscreteEquations, module: Module) -> str:
    """Write the text of a module, the same bytes for the same system and scheme.

    It imports only numba, math and numpy's array.
    """
    printer = Printer()
    kernels = [_kernel(kernel, printer) for kernel in module.kernels]
    functions = [_function(function, printer) for function in module.functions]
    constants = _constants(module, printer)
    limits = thresholds(equations, module)
    computed_tables = _computed_tables(equations, module)
    written = {function.name for function in module.functions}
    body = "\n".join([*kernels, *functions, computed_tables])
    library = [*_library(body, written, module.facts)]
    texts = [*kernels, *functions, *library]
    names = {
        node.id for node in ast.walk(ast.parse("\n".join(library))) if isinstance(node, ast.Name)
    }
    tables = _tables(equations, module, printer, set(_WORD.findall("\n".join(texts))))
    used = (printer.used | names.intersection(MATH)).difference(library_sources())
    imports = _imports(used, arrays=any("array(" in part for part in (tables, *library)))
    # what belongs to the system comes first, as that is what people look for
    first = [imports, _header(equations, module), _layout(module), tables, constants, limits]
    head = "\n".join([*filter(None, first), "compiled = njit(**OPTIONS)"])
    groups = [(_STEP, kernels), (_OF_SYSTEM, functions), (_SHARED, library)]
    parts = [head, *(_group(*group) for group in groups if group[1]), computed_tables]
    text = "\n\n\n".join(part.rstrip("\n") for part in parts if part) + "\n"
    documented = f'"""{docstring(equations, module)}"""\n\n{text}'
    digest = hashlib.sha256(documented.encode()).hexdigest()
    return f"{banner(equations)}# sha256 of what follows: {digest}\n{documented}"


def _group(title: str, functions: Iterable[str]) -> str:
    """Write functions below a title."""
    rule = "# " + "-" * (WIDTH - 2)
    return "\n\n\n".join([f"{rule}\n# {title}\n{rule}", *(text.strip("\n") for text in functions)])


def _imports(used: Iterable[str], *, arrays: bool) -> str:
    names = sorted(set(used))
    first = f"from math import {', '.join(names)}\n\n" if names else ""
    second = "from numpy import array\n" if arrays else ""
    return first + "from numba import carray, njit\n" + second + "\nreal = float\n"


def _header(equations: DiscreteEquations, module: Module) -> str:
    facts = "\n".join(
        line
        for name, value in _facts(equations, module).items()
        for line in folded(f'    "{name}": ', f"{_literal(value)},", "        ")
    )
    return f"""\
INTERFACE = {INTERFACE}
SIGNATURE = "{SIGNATURE}"
# contract and nsz keep NaN checks and compensated sums; "fast" would delete both
OPTIONS = {OPTIONS}
FACTS = {{
{facts}
}}
"""


def _facts(equations: DiscreteEquations, module: Module) -> dict[str, object]:
    """Return the entries of FACTS, the fields of :class:`symsimpson.text.header.Header`."""
    system, scheme, names = equations.system, equations.scheme, module.names
    plain = equations.plain
    signs = [
        next((s for s in ("positive", "negative") if getattr(a, f"is_{s}")), "")
        for a in system.parameters
    ]
    facts: dict[str, object] = {
        "system": system.name,
        "scheme": scheme.name,
        "digest": system.digest,
        "order": scheme.order,
        "coordinates": names.coordinates,
        "parameters": names.parameters,
        "defaults": tuple(float(value) for value in system.parameters.values()),
        "signs": tuple(signs),
        "real_everywhere": plain.signs.real_everywhere(n for _, n in plain.energies),
    }
    others = {
        "invariants": names.invariants,
        "forces": names.forces if plain.forces else (),
        "inputs": names.inputs,
        # texts, so that many digits are not lost
        "input_places": tuple(str(sp.N(c, 50)) for c in scheme.quadrature.nodes if names.inputs),
        "constraints": names.constraints,
        "carried": plain.carried,
        "conformal": plain.rate is not None,
        "retimed": system.retiming is not None,
    }
    facts |= {name: value for name, value in others.items() if value}
    facts |= {} if plain.autonomous else {"autonomous": False}
    if equations.varied is not None:
        facts |= {"varied_by": names.of(plain, equations.varied)}
    return facts


def _layout(module: Module) -> str:
    lines = ["# the workspace: first row of each block; a column is a lane", "LANES = 1"]
    lines += [f"{block} = {row}" for block, row in module.layout.items()]
    return "\n".join([*lines, f"ROWS = {module.rows}", ""])


def _tables(equations: DiscreteEquations, module: Module, printer: Printer, used: Set[str]) -> str:
    """Write numbers of the scheme, tables of it that are used, and what loops must know."""
    scheme = equations.scheme
    exact, numbers = Printer(exact=True), Expressions()

    def number(value: sp.Expr) -> str:
        # all of one type, because compiled code takes them in loops
        if value.is_Rational and value.q > _LARGE:  # a decimal number, as it was published
            return f'real("{Context(prec=99).divide(Decimal(value.p), Decimal(value.q))}")'
        return f"real({value})" if value.is_Integer else exact.text(numbers.read(value))

    def row(values: Iterable[sp.Expr]) -> str:
        return _literal_tuple(number(value) for value in values)

    d, n = scheme.degree, equations.system.n
    tables = {name: table for name, table in equations.tables.items() if name in used}
    lines = [
        f"# the scheme: {scheme.legend}" if tables else "# the scheme",
        f"DIMENSION = {n}",
        f"DEGREE = {d}",
        f"UNKNOWNS = {equations.unknowns.size}",
        f"NEWTON_UNKNOWNS = {module.newton_unknowns}",
        f"NODES = {scheme.stages}",
        f"ROW_ORDER = {_literal(equations.rows)}",
        f"COLUMN_ORDER = {_literal(equations.columns)}",
    ]
    lines += _scheme_tables(tables, row)
    lines += ["", "# how loops go over coordinates, unknowns and matrix entries"]
    for name, value in module.tables.items():
        lines += folded(f"{name} = ", _table(value, number), "    ")
    straight = tuple(kernel.name for kernel in module.kernels if kernel.straight)
    if straight:
        lines += ["", "# kernels without choices, whose loops are unrolled"]
        lines += [f"STRAIGHT = {_literal(straight)}"]
    printer.used |= exact.used
    return "\n".join([*lines, ""])


def _scheme_tables(tables: Mapping[str, Any], row: Callable[[Iterable[sp.Expr]], str]) -> list[str]:
    """Write the tables of a scheme as arrays: an index into a tuple compiles to branches."""
    lines = []
    for name, table in tables.items():
        if isinstance(table[0], sp.Expr):
            lines += folded(f"{name} = ", f"array({row(table)})", "    ")
            continue
        lines += [f"{name} = array(("]
        for values in table:
            lines += ["    " + line for line in folded("", row(values) + ",", "    ")]
        lines += ["))"]
    return lines


def _computed_tables(equations: DiscreteEquations, module: Module) -> str:
    """Write the calls by which a module computes its tables on import, and their DIGITS."""
    scheme = equations.scheme
    kind, s, d = scheme.quadrature.kind, scheme.stages, scheme.degree
    lines = []
    if not scheme.exact:
        names = "POINTS, PLACES, WEIGHTS, BASIS, BASIS_SLOPE, EXTRAPOLATION, END_SLOPE, START_SLOPE"
        more = d if equations.plain.velocity_constraints else 0
        lines.append(f'{names} = path_tables("{kind}", {s}, {d}, {more})')
    if "STRIDE" in module.tables:
        lines.append(f'STAGE_TABLE = stage_table("{kind}", {s})')
        if module.tables["UNFORCED"]:
            lines.append(f'STAGE_END = end_table("{kind}", {s})')
        if equations.looked_at:
            lines.append(f'REACHED_BY_MOVES = reach_table("{kind}", {s})')
    return "\n".join(["DIGITS = 40", "ONE = 10**DIGITS", *lines, ""]) if lines else ""


def _table(value: object, number: Callable[[sp.Expr], str]) -> str:
    """Write a table as an array, which is quick to index; short lists of integers as they are."""
    if isinstance(value, sp.Expr):
        return number(value)
    if not isinstance(value, tuple):
        return repr(value)
    if value and isinstance(value[0], int):
        text = _literal_tuple(map(repr, value))
        return f"array({text})" if len(value) > _LONG else text
    text = _literal_tuple(_table(item, number).removeprefix("array") for item in value)
    return f"array({text})"


def _constants(module: Module, printer: Printer) -> str:
    exact = Printer(exact=True)
    lines = [f"{symbol.name} = {exact.text(x)}" for symbol, x in module.constants.items()]
    lines = [*(f"{name} = {NAMED_CONSTANTS[name]!r}" for name in sorted(exact.constants)), *lines]
    printer.used |= exact.used
    return "\n".join(["# numbers that are not exact in binary", *lines, ""]) if lines else ""


def _library(body: str, written: Set[str], facts: Mapping[str, object]) -> Iterator[str]:
    """Return the library functions that the body calls, with conditions on facts resolved.

    Functions that the module has ``written`` for it stand in place of those of the same name.
    """
    sources = {name: text for name, text in library_sources().items() if name not in written}
    texts = called(re.findall(r"\b(\w+)\(", body), sources, facts)
    yield from (texts[name] for name in sources if name in texts)


def _function(function: Function, printer: Printer) -> str:
    lines = _statements(function.body, printer, 1)
    head = f"def {function.name}({', '.join(function.arguments)}):"
    return "\n".join(["@compiled", head, f'    """{function.doc}"""', *lines])


def _kernel(kernel: Kernel, printer: Printer) -> str:
    head = [
        f"def {kernel.name}(h, t, workspace):",
        f'    """{kernel.doc}"""',
        "    W = carray(workspace, (ROWS, LANES))",
    ]
    return "\n".join([*head, *_statements(kernel.body, printer, 1)])


def _statements(statements: Iterable[Statement], printer: Printer, depth: int) -> list[str]:
    lines: list[str] = []
    moves = ((_move(statement, printer), statement) for statement in statements)
    for block, group in groupby(moves, lambda pair: pair[0] and pair[0][0]):
        if block is None:
            lines += (line for _, x in group for line in _statement(x, printer, depth))
        else:
            lines += _moves((move[1:] for move, _ in group if move), depth)
    return lines or ["    " * depth + "pass"]


def _move(statement: Statement, printer: Printer) -> tuple[tuple[type, str], str, str] | None:
    """Return from or to which block a value is moved, its target and source; None for others."""
    match statement:
        case Load(target, row):
            return (Load, row.block), target.name, str(row)
        case Store(row, value, _, False) if not count_operations(value):
            return (Store, row.block), str(row), printer.text(value)
    return None


def _moves(moves: Iterable[tuple[str, str]], depth: int) -> Iterator[str]:
    """Write values that are moved, a few on a line."""
    some: list[tuple[str, str]] = []
    for move in moves:
        if len(some) == ON_A_LINE or (some and len(_line([*some, move], depth)) > WIDTH):
            yield _line(some, depth)
            some = []
        some.append(move)
    yield _line(some, depth)


def _line(moves: Sequence[tuple[str, str]], depth: int) -> str:
    targets, sources = zip(*moves, strict=True)
    return f"{'    ' * depth}{', '.join(targets)} = {', '.join(sources)}"


def _statement(statement: Statement, printer: Printer, depth: int) -> list[str]:
    pad = "    " * depth
    write = printer.text
    match statement:
        case Load():  # written with others of its block
            return []
        case ir.Assign(target, value):
            return folded(f"{pad}{target.name} = ", write(value), pad + "    ", parentheses=True)
        case Store(row, value, _, add):
            head = f"{pad}{row} {'+=' if add else '='} "
            return folded(head, write(value), pad + "    ", parentheses=True)
        case ir.Call(function, arguments, results):
            targets = f"{', '.join(x.name for x in results)} = " if results else ""
            given = (x if isinstance(x, str) else write(x) for x in arguments)
            return [f"{pad}{targets}{function}({', '.join(given)})"]
        case ir.Section(title, body):
            return [f"{pad}# {title}", *_statements(body, printer, depth)]
        case ir.Loop(index, over, body):
            return [f"{pad}for {index} in {over}:", *_statements(body, printer, depth + 1)]
        case ir.Excerpt(text):
            return [f"{pad}{line}" if line else "" for line in text]
        case ir.IfActive(body):
            return [f"{pad}if W[ACTIVE, lane] != 0:", *_statements(body, printer, depth + 1)]


def _literal(value: object) -> str:
    if isinstance(value, str):
        return f'"{value}"'
    if isinstance(value, tuple):
        return _literal_tuple(_literal(item) for item in value)
    return repr(value)


def _literal_tuple(items: Iterable[str]) -> str:
    parts = list(items)
    return f"({', '.join(parts)}{',' if len(parts) == 1 else ''})"
