"""Symbols of energies: coordinates, their momenta, and the time."""

from __future__ import annotations

from typing import Any, NoReturn

import sympy as sp
from sympy.core.function import AppliedUndef

from symsimpson.errors import ModelError, reject
from symsimpson.support.calling import explain_arguments
from symsimpson.support.names import speed_of_approach

#: The time, on which coordinates depend. It equals ``dynamicsymbols._t`` of SymPy, which is not
#: imported here because SymPy's mechanics takes long to import.
time: sp.Symbol = sp.Symbol("t")
#: The speed at which a gap closes, on which the restitution of an impact may depend.
approach: sp.Symbol = speed_of_approach()


@explain_arguments(ModelError)
def coordinates(names: str, *more: str, **assumed: object) -> tuple[AppliedUndef, ...]:
    """Make generalized coordinates: functions of time whose velocities are ``q.diff()``.

    Parameters
    ----------
    names : str
        Names separated by spaces or commas. ``"q:3"`` makes q0, q1, q2.
    *more
        Not accepted. Pass all names in one string.
    **assumed
        Not accepted. Coordinates have no assumptions such as ``positive=True``.

    Returns
    -------
    tuple of sympy functions of ``dynamicsymbols._t``
        A tuple, also for one name.

    Raises
    ------
    ModelError
        If there are no names, or the argument is not one string.

    Examples
    --------
    >>> import symsimpson as ss
    >>> q1, q2 = ss.coordinates("q1 q2")
    >>> q1.diff()
    Derivative(q1(t), t)
    """
    if more or not (isinstance(names, str) and names.replace(",", " ").split()):
        given = ", ".join(map(repr, (names, *more)))
        reject(
            f"coordinates needs one string with all names, not {given}.",
            remedy="Write q1, q2 = symsimpson.coordinates('q1 q2').",
            error=ModelError,
        )
    if assumed:
        words = [f"{name}={value!r}" for name, value in assumed.items()]
        reject(
            f"coordinates accept no assumptions such as {', '.join(words)}.",
            why="A coordinate is a real function of time, and may change its sign.",
            remedy="Remove the assumptions. Parameters accept them: "
            "sympy.symbols('m', positive=True).",
            error=ModelError,
        )
    try:
        functions = sp.symbols(names, cls=sp.Function)
    except ValueError as error:
        reject(
            f"coordinates cannot have the names {names!r}: {error}.",
            why="A colon denotes a range, such as 'q0:3'.",
            remedy="Write q1, q2 = symsimpson.coordinates('q1 q2').",
            error=ModelError,
        )
    if isinstance(functions, (tuple, list)):
        return tuple(function(time) for function in functions)
    return _Single((functions(time),))


class _Single(tuple[AppliedUndef, ...]):
    """A tuple of one coordinate, which rejects arithmetic as if it were the coordinate."""

    def __getattr__(self, name: str) -> Any:
        if name in ("diff", "dt", "subs"):
            self._reject()
        raise AttributeError(f"a tuple has no attribute {name!r}")

    def _reject(self, *_: object) -> NoReturn:
        name = self[0].func.__name__
        reject(
            f"this is the tuple ({name},) of one coordinate, not the coordinate.",
            remedy=f"Write ({name},) = symsimpson.coordinates({name!r}), with parentheses and a "
            "comma.",
            error=ModelError,
        )

    def __add__(self, other: Any) -> Any:
        return super().__add__(other) if isinstance(other, tuple) else self._reject()

    def __mul__(self, other: Any) -> Any:
        return super().__mul__(other) if isinstance(other, int) else self._reject()

    __rmul__ = __mul__
    __radd__ = __neg__ = __sub__ = __rsub__ = _reject
    __pow__ = __rpow__ = __truediv__ = __rtruediv__ = _reject


@explain_arguments(ModelError)
def momenta(*coordinates: AppliedUndef) -> tuple[sp.Symbol, ...]:
    """Return symbols of the conjugate momenta, for use in ``invariants``.

    Parameters
    ----------
    *coordinates : functions of time
        Coordinates from :func:`coordinates`.

    Returns
    -------
    tuple of sympy.Symbol
        Symbols named ``p_<coordinate>``.

    Raises
    ------
    ModelError
        If an argument is not a coordinate.

    Examples
    --------
    >>> import symsimpson as ss
    >>> ss.momenta(*ss.coordinates("x y"))
    (p_x, p_y)
    """
    for q in coordinates:
        if not isinstance(q, AppliedUndef):
            reject(
                f"momenta belong to coordinates, not to {q!r}.",
                remedy="Make q1, q2 = symsimpson.coordinates('q1 q2'), and write "
                "p1, p2 = symsimpson.momenta(q1, q2).",
                error=ModelError,
            )
    return tuple(sp.Symbol(f"p_{q.func.__name__}", real=True) for q in coordinates)
