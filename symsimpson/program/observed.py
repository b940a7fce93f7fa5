"""Quantities that follow from a state: their kernels, their values at many states."""

from __future__ import annotations

import ast
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from symsimpson.errors import reject
from symsimpson.program.input_values import read_array
from symsimpson.program.numbers import NO_INPUTS, workspace
from symsimpson.program.program import Program
from symsimpson.program.reader import OF_MATH, Reader
from symsimpson.program.recorders import Recorder
from symsimpson.support.array_types import Reals
from symsimpson.text.header import Header
from symsimpson.text.interface import FADED, MET, WATCHED, ZERO
from symsimpson.text.quantity import OBSERVABLE, VECTORS

#: Ways to reduce values over the steps of a run, in the order of their numbers; then what
#: variations of a motion tell, which are no values of states; then how often an event acted.
KINDS = ("min", "max", "mean", "first", "lyapunov", "megno", "sali", "count")
OF_STATES, OF_VARIATIONS, OF_EVENTS = KINDS[:4], KINDS[4:7], "count"
#: Functions whose slopes are at most 1: roundings of their arguments are those of their values.
SLOPES_TO_ONE = {"sin", "cos", "atan", "tanh", "abs", "min", "max"}


@dataclass(frozen=True)
class Observed:
    """A quantity."""

    expression: str  #: The quantity as it was asked for.
    text: str  #: The quantity as a Python expression in names of the kernel.
    #: Whether it contains the energy or velocities, which come from the kernel of the energy.
    energetic: bool
    wrapped: tuple[int, ...] = ()  #: Coordinates of which the turn between -pi and pi is meant.
    #: Whether it is a rest alone, as ``Mod(q1, 2*pi)``, which never changes its sign.
    rest: bool = False

    @property
    def constant(self) -> bool:
        """Whether numbers and parameters alone stand in it: it never changes."""
        parts = list(ast.walk(ast.parse(self.text, mode="eval")))
        called = {id(part.func) for part in parts if isinstance(part, ast.Call)}
        names = (x.id for x in parts if isinstance(x, ast.Name) and id(x) not in called)
        return all(name.startswith("a_") for name in names)

    @cached_property
    def size(self) -> str:
        """The sizes of its terms, added up, as an expression: what is rounded in it."""
        return _size(ast.parse(self.text, mode="eval").body)


def _size(node: ast.expr) -> str:
    """Return the size of an expression; the size of a function includes its arguments."""
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
class Reduction(Observed):
    """A quantity with a name, and what of its values is kept: one of ``KINDS``."""

    name: str = ""
    kind: str = KINDS[0]

    @property
    def asked(self) -> list[str]:
        """The name, the kind and the expression, as files keep them."""
        return [self.name, self.kind, self.expression]

    @property
    def of_variations(self) -> bool:
        """Whether it tells of variations of a motion."""
        return self.kind in OF_VARIATIONS

    @property
    def of_states(self) -> bool:
        """Whether it is taken over values at states."""
        return self.kind in OF_STATES


def read_expression(
    program: Program, expression: Any, wrapped: tuple[int, ...] = (), what: str = "the expression"
) -> Observed:
    """Read an expression, a text or of SymPy; an equation means the difference of its sides.

    Errors tell ``what`` it is. Raises InputError if it contains something else than arithmetic,
    functions and the names of coordinates, momenta, velocities, parameters, t, energy and
    kinetic_energy.
    """
    reader = Reader(program, what)
    text = reader.read_any(expression)
    return Observed(str(expression), text, reader.energetic, wrapped, reader.rest)


def refuse_constant(observed: Observed, what: str) -> None:
    """Refuse an expression that never changes its sign, as nothing that changes stands in it.

    Raises InputError.
    """
    if observed.constant:
        reject(
            f"{what} has no coordinate, velocity or time in it: it never changes.",
            remedy="Write what is zero where the event takes place.",
        )


def read_reductions(
    program: Program, given: Mapping[str, Any] | None, event_names: Sequence[str] | None = None
) -> tuple[Reduction, ...]:
    """Read a mapping from names to pairs of a kind and an expression, or the name of an event.

    Raises InputError if a kind is unknown, if none of the ``event_names`` has the name, and for
    expressions as :func:`read_expression`.
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
                f"reduce[{name!r}] tells how variations grow, which is not measured "
                "through events.",
                remedy="Leave it out, or the events.",
            )
        if kind in OF_VARIATIONS and str(expression) in ("None", ""):
            reductions.append(Reduction("", "0.0", False, name=str(name), kind=kind))
            continue
        if kind == OF_EVENTS and expression is not None:
            if event_names is not None and str(expression) not in event_names:
                reject(
                    f"reduce[{name!r}] counts {str(expression)!r}, and no event is called so.",
                    remedy="Events of this call are "
                    f"{', '.join(event_names) or 'none: pass events='}.",
                )
            reductions.append(Reduction(str(expression), "0.0", False, name=str(name), kind=kind))
            continue
        if kind not in OF_STATES or expression is None:
            reject(
                f"reduce[{name!r}] is {pair!r}.",
                remedy=f"Pass a pair of one of {', '.join(OF_STATES)} and "
                "an expression, such as ('max', 'q1') or ('first', 'q1 - 3'); one of "
                f"{', '.join(OF_VARIATIONS)}; or ('count', name of an event).",
            )
        if kind == "mean" and program.header.retimed:
            reject(
                f"{program.system} is retimed: the mean over its steps is no mean over the time.",
                remedy="Store states, every=..., and take the mean of them.",
            )
        reader = Reader(program, f"reduce[{name!r}]")
        text = reader.read_any(expression)
        portable = reader.portable(expression, text)
        reductions.append(Reduction(portable, text, reader.energetic, name=str(name), kind=kind))
    return tuple(reductions)


def observing_kernel(header: Header, observed: Sequence[Observed]) -> str:
    """Write a kernel that puts the quantities into rows behind those of the module."""
    places = enumerate(observed, header.rows)
    return _kernel(
        "Quantities that are watched.",
        _names(header),
        (f"W[{row}, lane] = {quantity.text}" for row, quantity in places),
    )


def observers(header: Header, reductions: Sequence[Reduction], first: int) -> tuple[Recorder, ...]:
    """Return what reduces quantities over the states of a run.

    From the ``first`` row on, which is behind all others, there are two for each: what it came to,
    NaN at first, and the value at the state before; then how many states were looked at.
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
    energy = (Recorder("energy", of_states=True),) if any(x.energetic for _, x in watched) else ()
    rows = 2 * len(reductions) + 1
    return *energy, Recorder("observe", first, room=rows, text=text, of_states=True)


def watchers(
    header: Header,
    watched: Sequence[Observed],
    signs: Sequence[int],
    gaps: Sequence[bool],
    first: int,
    *,
    values: bool = False,
) -> tuple[Recorder, ...]:
    """Return what stops a run after a step in which an expression changes its sign.

    From the ``first`` row on there are four for each: the side of zero on which it is, NaN where
    that is not known, a half of it while it rests at zero, twice of it at a zero; its size of late,
    of a gap its largest (bodies that touch for long are apart by rounding of what they moved
    before), its value, and the value before, which only gaps need; with ``values`` all have theirs.
    ``signs`` are those that are waited for, or 0; a gap may also pass through zero and come back
    within a step. A step that begins at a zero of another expression stops the run, too.
    """
    lines, kept = list(_names(header)), list[str]()
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
        kept += [f"{side}, {size} = now_{k}, size_{k}"]
        if values and not gap:
            kept.append(f"{before} = value_{k}")
        if gap:
            kept.append(f"{earlier}, {before} = {before}, value_{k}")
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
    lines += [f"    {line}" for line in kept]
    text = _kernel("Signs of expressions that are waited for.", [], _where_active(lines))
    energetic = any(x.energetic for x in watched)
    energy = (Recorder("energy", of_events=True),) if energetic else ()
    room = WATCHED * len(watched)
    return *energy, Recorder("watch", first, room=room, text=text, of_events=True)


def _where_active(lines: Sequence[str]) -> list[str]:
    """Return lines that are done in lanes that go on."""
    return ["if W[ACTIVE, lane] > 0.0:", *(f"    {line}" for line in lines)]


def _reduced(kind: str, row: int, now: str, passed: str) -> list[str]:
    """Return lines that reduce a ``value`` into a row, where ``number`` values were before."""
    kept, before = f"W[{row}, lane]", f"W[{row + 1}, lane]"
    if kind == "mean":
        return [
            f"mean = {kept} + (value - {kept}) / (number + 1.0)",
            f"{kept} = value if number == 0.0 else mean",
        ]
    if kind != "first":
        sign = "<" if kind == "min" else ">"
        return [
            f"further = value if value {sign} {kept} else {kept}",
            f"{kept} = value if number == 0.0 else further",
        ]
    # it is NaN until the value is positive
    return [
        "if value > 0.0:",
        "    if number == 0.0:",
        f"        {kept} = {now}",
        f"    elif {kept} != {kept}:",
        f"        {kept} = {now} - ({passed}) * value / (value - {before})",
        f"{before} = value",
    ]


def _names(header: Header) -> list[str]:
    """Return lines that give quantities of a state the names that expressions have for them."""
    rows = [(f"{x.symbol}{i}", f"{x.block} + {i}") for x in VECTORS for i in range(header.n)]
    rows += [(f"a_{i}", f"PARAMETER + {i}") for i in range(len(header.parameters))]
    rows += [(x.symbol, x.block) for x in OBSERVABLE]
    return [f"{name} = W[{row}, lane]" for name, row in rows]


def _kernel(doc: str, names: Sequence[str], lines: Iterable[str]) -> str:
    """Return the text of a kernel for each lane."""
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


def evaluate(
    program: Program,
    kernel: str,
    block: str,
    count: int,
    states: tuple[Reals, Reals, Reals],
    values: Reals,
    inputs: Reals = NO_INPUTS,
) -> Reals:
    """Evaluate a kernel of the state at many states (t, q, p); shape (..., count).

    ``q`` and ``p`` have shape (..., n); the kernel "legendre" takes velocities in place of p.
    Parameters have ``values`` of shape (m,), or (K, m) if the first axis of ``q`` counts members.
    ``inputs`` have states in the places of steps; they stand in powers alone. Fast sines have no
    value for huge angles: there the library's are taken.
    """
    header, numbers, kernels = program.header, program.numbers, program.kernels
    driver, shape = numbers.driver("evaluate"), states[1].shape[:-1]
    with numbers.working():
        rows_of_values = np.atleast_2d(numbers.read(values))
        W, unit = workspace(header, numbers, rows_of_values[0]), numbers.read(1.0).item()
        t, q, p = map(numbers.read, states)
        t = t if t.shape == shape else np.broadcast_to(t, shape).copy()
        t, q, p = t.reshape(-1), q.reshape(-1, header.n), p.reshape(-1, header.n)

        def at(some: Any, values: Reals, inputs: Reals, *, any_angle: bool) -> Reals:
            address = kernels.address(kernel, any_angle=any_angle)
            addresses, here = (kernels.address("prepare"), 0, address), (t[some], q[some], p[some])
            out, given = numbers.zeros((len(here[0]), count)), (inputs, values)
            setting = unit, W, header.driver_layout, here, header.layout[block]
            driver(addresses, *setting, out, given)
            return numbers.result(out)

        rows = at(slice(None), rows_of_values, inputs, any_angle=False)
        if header.fast_sines and not numbers.all_finite(rows):
            known = numbers.finite(q).all(axis=1) & numbers.finite(p).all(axis=1)
            again = np.flatnonzero(known & ~numbers.finite(rows).all(axis=1))
            if again.size:
                some_values = rows_of_values[again * len(rows_of_values) // len(rows)]
                some_inputs = inputs if inputs.shape[1] == 1 else inputs[:, again]
                rows[again] = at(again, some_values, some_inputs, any_angle=True)
    return rows.reshape(*shape, count)


def observer(
    program: Program, observed: Sequence[Observed], values: Reals, kernel: Any = None
) -> tuple[tuple[int, int, int], Reals]:
    """Return what evaluates expressions: prepare, the energy and a kernel; and their workspace.

    The ``kernel`` is compiled unless it is given. Raises InputError if the stepper has many digits.
    """
    header, numbers, kernels = program.header, program.numbers, program.kernels
    if kernel is None:
        kernel = kernels.compile_observer(observing_kernel(header, observed), len(observed))
    W = workspace(header, numbers, np.atleast_2d(numbers.read(values))[0], more=len(observed))
    return (kernels.address("prepare"), kernels.address("energy"), kernel), W


def watching(
    program: Program, observed: Sequence[Observed], values: Reals, kernel: Any = None
) -> Callable[[Reals, Reals, Reals], Reals]:
    """Return what evaluates expressions at many states (t, q, p); shape (len(q), len(observed)).

    Parameters have ``values`` of shape (m,), or (K, m) if equally many states of K members follow
    one another. The ``kernel`` is compiled unless it is given. Raises InputError if the stepper has
    many digits.
    """
    header, numbers = program.header, program.numbers
    (prepare, energy, kernel), W = observer(program, observed, values, kernel)
    # asked for one state often: all but the states is found once
    addresses = prepare, energy if any(quantity.energetic for quantity in observed) else 0, kernel
    driver = numbers.driver("evaluate")
    first, about, count = header.rows, header.driver_layout, len(observed)
    given = NO_INPUTS, np.atleast_2d(numbers.read(values))

    def watch(t: Reals, q: Reals, p: Reals) -> Reals:
        out = numbers.zeros((len(q), count))
        # copies: what came from a file, or from another process, may be read-only
        states = tuple(np.array(x, dtype=out.dtype, order="C") for x in (t, q, p))
        driver(addresses, 1.0, W, about, states, first, out, given)
        return out

    return watch


def evaluate_energy(
    program: Program,
    given_q: ArrayLike,
    given_p: ArrayLike,
    parameters: Mapping[Any, Any] | None,
    t: ArrayLike,
) -> Reals:
    """Evaluate the Hamiltonian at states of any origin."""
    numbers, n = program.numbers, program.n
    with numbers.working():
        states = [read_array(name, x, numbers) for name, x in (("q", given_q), ("p", given_p))]
        for name, state in zip("qp", states, strict=True):
            if state.ndim != 2 or state.shape != (len(states[0]), n):
                reject(
                    f"{name} has shape {state.shape}, expected (N, {n}).",
                    remedy="Pass one row for each state; q and p of equal length.",
                )
        values = program.values(parameters)
        times = np.broadcast_to(read_array("t", t, numbers), len(states[0]))
    q, p = states
    energies: Reals = evaluate(program, "energy", "ENERGY", 1, (times, q, p), values)
    return energies[:, 0]
