"""Quantities that are functions of a state: their kernels, and their values at many states."""

from __future__ import annotations

import ast
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from symsimpson.errors import reject
from symsimpson.program.program import Program
from symsimpson.program.reader import OF_MATH, ExpressionParser
from symsimpson.program.recorders import Recorder
from symsimpson.text.header import Header
from symsimpson.text.interface import FADED, MET, WATCHED, ZERO
from symsimpson.text.quantity import MULTIPLIERS, OBSERVABLE, VECTORS
from symsimpson.text.workspace_layout import DRIVER_LAYOUT

#: Reductions over the steps of a run, in the order of their numbers: four of values at states,
#: three of variations, and the number of times that an event acted.
KINDS = ("min", "max", "mean", "first", "lyapunov", "megno", "sali", "count")
OF_STATES, OF_VARIATIONS, OF_EVENTS = KINDS[:4], KINDS[4:7], "count"
#: Functions whose slopes are at most 1. They do not amplify the round-off of their argument.
SLOPES_TO_ONE = {"sin", "cos", "atan", "tanh", "abs", "min", "max"}


@dataclass(frozen=True)
class ObservedExpression:
    """An expression of the user that the run evaluates at states."""

    expression: str  #: The expression of the user.
    text: str  #: The expression in Python, with the names of the kernel.
    #: Whether it contains the energy or velocities, which the energy kernel computes.
    energetic: bool
    wrapped: tuple[int, ...] = ()  #: Coordinates whose angle is wrapped to -pi..pi.
    #: Whether it is a remainder such as ``Mod(q1, 2*pi)``, which never changes its sign.
    rest: bool = False
    held: bool = False  #: Whether it contains multipliers, which the multipliers kernel computes.
    driven: bool = False  #: Whether it depends on the inputs, as multipliers may.

    @property
    def constant(self) -> bool:
        """True if the expression contains only numbers and parameters, and so never changes."""
        parts = list(ast.walk(ast.parse(self.text, mode="eval")))
        called = {id(part.func) for part in parts if isinstance(part, ast.Call)}
        names = (x.id for x in parts if isinstance(x, ast.Name) and id(x) not in called)
        return all(name.startswith("a_") for name in names)

    @cached_property
    def size(self) -> str:
        """The sum of the moduli of its terms, as an expression. Its round-off is relative to it."""
        return _size(ast.parse(self.text, mode="eval").body)


def _size(node: ast.expr) -> str:
    """Return the sum of the moduli of all terms, including terms in arguments of functions."""
    value = f"abs({ast.unparse(node)})"
    match node:
        case ast.BinOp(left=left, op=ast.Add() | ast.Sub(), right=right):
            return f"{_size(left)} + {_size(right)}"
        case ast.UnaryOp(op=ast.USub(), operand=ast.BinOp() | ast.Call() as operand):
            return _size(operand)
        case ast.BinOp(left=left, op=ast.Mult(), right=right):
            a, b, first, last = _size(left), _size(right), ast.unparse(left), ast.unparse(right)
            if (a, b) != (f"abs({first})", f"abs({last})"):
                return f"({a}) * abs({last}) + abs({first}) * ({b})"
        case ast.BinOp(left=ast.BinOp() | ast.Call() as left, op=ast.Div(), right=right):
            return f"({_size(left)}) / abs({ast.unparse(right)})"
        case ast.BinOp(left=left, op=ast.Pow(), right=ast.Constant(value=int() | float() as n)) if (
            n > 1
        ):
            return f"{value} + {n} * abs({ast.unparse(left)}) ** {n - 1} * ({_size(left)})"
        case ast.BinOp(left=left, op=ast.Mod()):
            return f"{value} + {_size(left)}"
        case ast.Call(func=ast.Name(id=name), args=arguments) if name in SLOPES_TO_ONE:
            return " + ".join([value, *map(_size, arguments)])
    return value


@dataclass(frozen=True)
class Reduction(ObservedExpression):
    """An expression with a name, and the kind of its reduction over a run: one of ``KINDS``."""

    name: str = ""
    kind: str = KINDS[0]

    @property
    def entries(self) -> list[str]:
        """The name, the kind and the expression, for files."""
        return [self.name, self.kind, self.expression]

    @property
    def of_variations(self) -> bool:
        """True if the reduction measures the growth of variations."""
        return self.kind in OF_VARIATIONS

    @property
    def of_states(self) -> bool:
        """True if the reduction is over values at states."""
        return self.kind in OF_STATES


def read_expression(
    program: Program, expression: Any, wrapped: tuple[int, ...] = (), what: str = "the expression"
) -> ObservedExpression:
    """Read an expression, a text or SymPy; an equation means the difference of its sides.

    ``what`` names the expression in messages. It may contain arithmetic, functions, and the names
    of coordinates, momenta, velocities, parameters, t, energy and kinetic_energy. Raises InputError
    for anything else.
    """
    if isinstance(expression, ObservedExpression):
        return expression
    parser = ExpressionParser(program, what)
    text = parser.parse(expression)
    flags = parser.energetic, wrapped, parser.rest, parser.with_multipliers
    return ObservedExpression(str(expression), text, *flags)


def check_not_constant(observed: ObservedExpression, what: str) -> None:
    """Raise InputError for an expression without coordinates, velocities and time."""
    if observed.constant:
        reject(
            f"{what} contains no coordinate, velocity or time, so it never changes.",
            remedy="Write an expression that is zero where the event takes place.",
        )


def read_reductions(
    program: Program, given: Mapping[str, Any] | None, event_names: Sequence[str] | None = None
) -> tuple[Reduction, ...]:
    """Read the argument ``reduce``: a mapping from names to pairs of a kind and an expression.

    A pair ("count", name) has the name of an event. Raises InputError if a kind or an event is
    unknown, and for the same expressions as :func:`read_expression`.
    """
    if given is None:
        return ()
    if not isinstance(given, Mapping):
        reject(
            f"reduce is {type(given).__name__}, not a mapping.",
            remedy="Pass reduce={'highest': ('max', 'q1')}.",
        )
    reductions = []
    for name, pair in given.items():
        kind, expression = pair if isinstance(pair, tuple) and len(pair) == 2 else (pair, None)
        kind = kind if isinstance(kind, str) else ""
        if event_names and kind in OF_VARIATIONS:
            reject(
                f"reduce[{name!r}] is {kind!r}, the growth of variations.",
                why="Runs with events do not measure it.",
                remedy="Remove this reduction, or the events.",
            )
        if kind in OF_VARIATIONS and str(expression) in ("None", ""):
            reductions.append(Reduction("", "0.0", False, name=str(name), kind=kind))
            continue
        if kind == OF_EVENTS and expression is not None:
            if event_names is not None and str(expression) not in event_names:
                reject(
                    f"reduce[{name!r}] counts {str(expression)!r}, but no event has this name.",
                    remedy=f"The events of this call are {', '.join(event_names)}."
                    if event_names
                    else "This call has no events: pass events=.",
                )
            reductions.append(Reduction(str(expression), "0.0", False, name=str(name), kind=kind))
            continue
        if kind not in OF_STATES or expression is None:
            reject(
                f"reduce[{name!r}] is {pair!r}, which is no reduction.",
                remedy=f"Pass a pair of one of {', '.join(OF_STATES)} and an expression, such as "
                "('max', 'q1') or ('first', 'q1 - 3'). Or pass one of "
                f"{', '.join(OF_VARIATIONS)}, or ('count', name of an event).",
            )
        if kind == "mean" and program.header.retimed:
            reject(
                f"{program.system} has a time transformation, so the mean over its steps is not "
                "the mean over time.",
                remedy="Store states with every=..., and compute their mean.",
            )
        parser = ExpressionParser(program, f"reduce[{name!r}]")
        text = parser.parse(expression)
        portable = parser.to_portable(expression, text)
        about: dict[str, Any] = {"held": parser.with_multipliers, "name": str(name), "kind": kind}
        reductions.append(Reduction(portable, text, parser.energetic, **about))
    return tuple(reductions)


def kernels_before(observed: Sequence[ObservedExpression]) -> list[str]:
    """Return the kernels that must run, in this order, before the expressions are evaluated.

    The kernel of multipliers computes velocities, too.
    """
    last = ["multipliers"] if any(quantity.held for quantity in observed) else []
    energies = [x for x in observed if x.energetic and not (last and "energy" not in x.text)]
    return (["energy"] if energies else []) + last


def observing_kernel(header: Header, observed: Sequence[ObservedExpression]) -> str:
    """Write a kernel that stores the values in rows after the rows of the module."""
    places = enumerate(observed, header.rows)
    return _kernel(
        "Quantities that are watched.",
        _names(header),
        (f"W[{row}, lane] = {quantity.text}" for row, quantity in places),
    )


def reduction_recorders(
    header: Header, reductions: Sequence[Reduction], first: int
) -> tuple[Recorder, ...]:
    """Return the recorders that reduce expressions over the states of a run.

    Each reduction has two rows from the row ``first`` on: its result, initially NaN, and the value
    at the previous state. The last row counts the states.
    """
    watched = [
        (first + 2 * k, reduction) for k, reduction in enumerate(reductions) if reduction.of_states
    ]
    if not watched:
        return ()
    count = first + 2 * len(reductions)
    names = _names(header)
    now, passed = "t", "h"
    if header.retimed:
        names.append("t = W[TIME, lane]")
        passed = "W[TIME, lane] - W[TIME + 2, lane]"
    lines = [*names, f"number = W[{count}, lane]"]
    for row, quantity in watched:
        lines += [f"value = {quantity.text}", *_reduced(quantity.kind, row, now, passed)]
    lines.append(f"W[{count}, lane] = number + 1.0")
    text = _kernel("Quantities that are watched, reduced over states.", [], _where_active(lines))
    needed = (Recorder(x, of_states=True) for x in kernels_before([x for _, x in watched]))
    rows = 2 * len(reductions) + 1
    return *needed, Recorder("observe", first, room=rows, text=text, of_states=True)


def event_recorders(
    header: Header,
    watched: Sequence[ObservedExpression],
    signs: Sequence[int],
    gaps: Sequence[bool],
    first: int,
    *,
    values: bool = False,
) -> tuple[Recorder, ...]:
    """Return the recorders that stop a run after a step in which an expression changes its sign.

    Each expression has four rows from the row ``first`` on:

    - its sign; NaN if unknown, +-1/2 while it rests at zero, +-2 at a zero;
    - its recent size, or the largest size of a gap. Bodies in long contact have a distance of the
      round-off of their earlier motion;
    - its value, for gaps, or for all expressions if ``values``;
    - the value before, only for gaps.

    ``signs`` are the signs after the change, or 0 for both. A gap may also pass zero and return
    within one step. A step that begins at a zero of another expression stops the run, too.
    """
    lines, updates = list(_names(header)), list[str]()
    for k, (quantity, sign, gap) in enumerate(zip(watched, signs, gaps, strict=True)):
        row = first + WATCHED * k
        side, size, before, earlier = (f"W[{row + i}, lane]" for i in range(WATCHED))
        waited = f"side * now_{k} < 0.0" + (f" and now_{k} == {sign}.0" if sign else "")
        waited += "" if gap else " or abs(side) > 1.0"  # it may act where the step begins
        near = "side" if gap else "2.0 * side * abs(side)"
        lines += [
            f"value_{k} = {quantity.text}",
            f"side = {side}",
            f"size_{k} = {quantity.size}",
            f"least = {1.0 if gap else FADED} * {size}",
            f"size_{k} = size_{k} if size_{k} > least else least",
            f"small = {ZERO!r} * size_{k}",
            f"now_{k} = 1.0 if value_{k} > small else (-1.0 if value_{k} < -small else {near})",
            f"met_{k} = 1.0 if {waited} else (1.0 if now_{k} != now_{k} else 0.0)",
        ]
        updates += [f"{side}, {size} = now_{k}, size_{k}"]
        if values and not gap:
            updates.append(f"{before} = value_{k}")
        if gap:
            updates.append(f"{earlier}, {before} = {before}, value_{k}")
            lines += [
                f"falls = {earlier} - {before}",
                f"rises = 2.0 * (value_{k} - {before}) + falls",
                f"low = value_{k} if value_{k} < {before} else {before}",
                "most = falls if falls > rises else rises",
                "dips = low > small and falls > 0.0 and rises > 0.0 and low < most",
                f"lost = value_{k} != value_{k} or (side != side and now_{k} < 0.0)",
                f"met_{k} = 1.0 if dips or lost else met_{k}",
            ]
    lines.append(f"met = {' + '.join(f'met_{k}' for k in range(len(watched)))}")
    lines += ["if met > 0.0:", f"    W[STATUS, lane] = {MET}.0", "else:"]
    lines += [f"    {line}" for line in updates]
    text = _kernel("Signs of the watched expressions.", [], _where_active(lines))
    needed = (Recorder(kernel, of_events=True) for kernel in kernels_before(watched))
    room = WATCHED * len(watched)
    return *needed, Recorder("watch", first, room=room, text=text, of_events=True)


def _where_active(lines: Sequence[str]) -> list[str]:
    """Return lines that only active lanes execute."""
    return ["if W[ACTIVE, lane] > 0.0:", *(f"    {line}" for line in lines)]


def _reduced(kind: str, row: int, now: str, passed: str) -> list[str]:
    """Return lines that add a ``value`` to the reduction in a row, after ``number`` values."""
    result, before = f"W[{row}, lane]", f"W[{row + 1}, lane]"
    if kind == "mean":
        return [
            f"mean = {result} + (value - {result}) / (number + 1.0)",
            f"{result} = value if number == 0.0 else mean",
        ]
    if kind != "first":
        sign = "<" if kind == "min" else ">"
        return [
            f"further = value if value {sign} {result} else {result}",
            f"{result} = value if number == 0.0 else further",
        ]
    # the result is NaN until the value is positive
    return [
        "if value > 0.0:",
        "    if number == 0.0:",
        f"        {result} = {now}",
        f"    elif {result} != {result}:",
        f"        {result} = {now} - ({passed}) * value / (value - {before})",
        f"{before} = value",
    ]


def _names(header: Header) -> list[str]:
    """Return lines that assign the quantities of a state to the names in expressions."""
    rows = [(f"{x.symbol}{i}", f"{x.block} + {i}") for x in VECTORS for i in range(header.n)]
    rows += [(f"a_{i}", f"PARAMETER + {i}") for i in range(len(header.parameters))]
    rows += [(x.symbol, x.block) for x in OBSERVABLE]
    multipliers = range(len(header.constraints))
    rows += [(f"{MULTIPLIERS.symbol}{i}", f"MULTIPLIER + {i}") for i in multipliers]
    stride = int(header.driver_layout[DRIVER_LAYOUT["INPUT_STRIDE"]]) if header.inputs else 0
    rows += [(f"u_{i}", f"INPUT + {i * stride}") for i in range(len(header.inputs))]
    return [f"{name} = W[{row}, lane]" for name, row in rows]


def _kernel(doc: str, names: Sequence[str], lines: Iterable[str]) -> str:
    """Return the text of a kernel that executes the lines for each lane."""
    return "\n".join(
        [
            f"from math import {OF_MATH}",
            "",
            "",
            "def observe(h, t, workspace):",
            f'    """{doc}"""',
            "    W = carray(workspace, (ROWS, LANES))",
            "    for lane in range(LANES):",
            *(f"        {line}" for line in (*names, *lines)),
            "",
        ]
    )
