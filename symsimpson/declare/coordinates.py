"""Symbols that users write energies with: coordinates, their momenta, and the time."""

from __future__ import annotations

from typing import Any, NoReturn

import sympy as sp
from sympy.core.function import AppliedUndef

from symsimpson.errors import ModelError, reject
from symsimpson.support.calling import explained
from symsimpson.support.names import speed_of_approach

#: The time, equal to ``dynamicsymbols._t`` of SymPy, of which coordinates are functions. It is made
#: here because SymPy's mechanics, with units and constants, takes long to import.
time: sp.Symbol = sp.Symbol("t")
#: The speed at which a gap closes, of which the restitution of an impact may be a function.
approach: sp.Symbol = speed_of_approach()


@explained(ModelError)
def coordinates(names: str, *more: str, **assumed: object) -> tuple[AppliedUndef, ...]:
    """Make generalized coordinates: functions of time whose velocities are ``q.diff()``.

    Parameters
    ----------
    names : str
        Names separated by spaces or commas; ``"q:3"`` stands for q0, q1, q2.
    *more
        Not accepted: a second text is refused in words.
    **assumed
        Not accepted: coordinates have no assumptions, as ``positive=True`` of SymPy's symbols.

    Returns
    -------
    tuple of sympy functions of ``dynamicsymbols._t``
        Always a tuple, also for one name.

    Raises
    ------
    ModelError
        If there are no names, or something else than one text.

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
            f"coordinates are named by one text with their names, not by {given}.",
            remedy="Write q1, q2 = symsimpson.coordinates('q1 q2').",
            error=ModelError,
        )
    if assumed:
        words = [f"{name}={value!r}" for name, value in assumed.items()]
        reject(
            f"coordinates accept no assumptions such as {', '.join(words)}.",
            remedy="A coordinate is a "
            "real function of time, and its motion may change its sign. Leave them out. "
            "Parameters accept them: sympy.symbols('m', positive=True).",
            error=ModelError,
        )
    try:
        functions = sp.symbols(names, cls=sp.Function)
    except ValueError as error:
        reject(
            f"coordinates cannot be called {names!r}: {error}.",
            remedy="A colon stands for a range, as in "
            "'q0:3'; write q1, q2 = symsimpson.coordinates('q1 q2').",
            error=ModelError,
        )
    if isinstance(functions, (tuple, list)):
        return tuple(function(time) for function in functions)
    return _Single((functions(time),))


class _Single(tuple[AppliedUndef, ...]):
    """One coordinate in its tuple, which tells those who calculate with it as if it were none."""

    def __getattr__(self, name: str) -> Any:
        if name in ("diff", "dt", "subs"):
            self._refuse()
        raise AttributeError(f"a tuple has no attribute {name!r}")

    def _refuse(self, *_: object) -> NoReturn:
        name = self[0].func.__name__
        reject(
            f"this is the tuple ({name},) of one coordinate, not the coordinate.",
            remedy=f"Write ({name},) = symsimpson.coordinates({name!r}), with brackets "
            "and a comma.",
            error=ModelError,
        )

    def __add__(self, other: Any) -> Any:
        return super().__add__(other) if isinstance(other, tuple) else self._refuse()

    def __mul__(self, other: Any) -> Any:
        return super().__mul__(other) if isinstance(other, int) else self._refuse()

    __rmul__ = __mul__
    __radd__ = __neg__ = __sub__ = __rsub__ = _refuse
    __pow__ = __rpow__ = __truediv__ = __rtruediv__ = _refuse


@explained(ModelError)
def momenta(*coordinates: AppliedUndef) -> tuple[sp.Symbol, ...]:
    """Return the symbols that stand for the conjugate momenta in ``invariants``.

    Parameters
    ----------
    *coordinates : functions of time
        As made by :func:`coordinates`.

    Returns
    -------
    tuple of sympy.Symbol
        Named ``p_<coordinate>``.

    Raises
    ------
    ModelError
        If something else is given.

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
