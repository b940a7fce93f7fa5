"""Contacts and dry friction, as users declare them for a system."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any, Final

import sympy as sp

from symsimpson.declare.checks import reject_model, spell
from symsimpson.errors import ModelError, reject
from symsimpson.support.calling import explain_methods
from symsimpson.support.markup import fields_given

#: The speed abs(u) of sliding, for limits and coefficients of friction.
slip: Final = sp.Symbol("slip", nonnegative=True)


class _Element:
    """An entry of ``contacts`` or ``friction``."""

    def replaced(self, change: Any) -> Any:
        """Return a copy whose expressions are changed by a function."""
        given = {f.name: getattr(self, f.name) for f in fields(self)}  # type: ignore[arg-type]
        some = {key: change(x) for key, x in given.items() if isinstance(x, sp.Basic)}
        return replace(self, **some)  # type: ignore[type-var]

    @property
    def free_symbols(self) -> set[sp.Basic]:
        """Symbols in the expressions."""
        given = (getattr(self, f.name) for f in fields(self))  # type: ignore[arg-type]
        return set().union(*(getattr(x, "free_symbols", ()) for x in given))

    def _repr_html_(self) -> str:
        return fields_given(type(self).__name__, self)


@explain_methods(ModelError, also=("__init__",))
@dataclass(frozen=True)
class Friction(_Element):
    """Dry friction with a given limit: it sticks, or slides against a force of this size.

    Parameters
    ----------
    velocity : SymPy expression
        Relative velocity u of the surfaces, linear in the velocities: ``x.diff() - v_belt``.
    limit : number or expression
        Size of the friction force while u differs from 0. It may contain coordinates, parameters,
        inputs, the time and the speed of sliding, :data:`symsimpson.slip`.
    static : number or expression, optional
        Largest size of the force while it sticks. By default, the limit at ``slip`` = 0.
    name : str, optional
        Name in results. By default, the key in ``friction=``, or the number in a list.

    Raises
    ------
    ModelError
        If a limit is negative, or smaller while it sticks.

    Notes
    -----
    The friction is -nu du/dv, with nu = limit sign(u) in sliding, and abs(nu) <= static in
    sticking. A run changes between these modes at events, at the full order of the scheme.

    Examples
    --------
    >>> import symsimpson as ss
    >>> (x,) = ss.coordinates("x")
    >>> brake = ss.MechanicalSystem("brake", coordinates=(x,), kinetic=x.diff()**2/2,
    ...                             potential=0*x, friction={"pad": ss.Friction(x.diff(), limit=2)})
    >>> run = ss.compile(brake).integrate([0.0], v0=[1.0], h=0.1, t_end=1.0)
    >>> run.events("pad").kind, run.events("pad").t.round(9), run["x"][-1:].round(9)
    (['stick'], array([0.5]), array([0.25]))
    """

    velocity: Any
    limit: Any = field(kw_only=True)
    static: Any = field(default=None, kw_only=True)
    name: str | None = field(default=None, kw_only=True)

    def __post_init__(self) -> None:
        _check_velocity(self.velocity, "Friction")
        _check_limits("the limit", self.limit, self.static)


@explain_methods(ModelError, also=("__init__",))
@dataclass(frozen=True)
class Contact(_Element):
    """A contact gap(q, t) >= 0 that collides, rests and leaves, with or without dry friction.

    Parameters
    ----------
    gap : SymPy expression
        Distance of the bodies, an expression of coordinates, parameters and the time. It is
        positive where they are apart.
    restitution : number or expression, default 0
        Newton's coefficient of restitution, between 0 (plastic) and 1 (elastic). It may contain
        parameters and the speed of approach, :data:`symsimpson.approach`.
    friction : number or expression, optional
        Coulomb's coefficient mu >= 0: the friction is at most mu times the normal force. It may
        contain the speed of sliding, :data:`symsimpson.slip`. By default, there is no friction.
    slip : SymPy expression, optional
        Relative velocity with which the contact slides, linear in the velocities. Friction needs
        it. The motion is in the plane.
    static : number or expression, optional
        Coefficient while the contact sticks. By default, ``friction`` at ``slip`` = 0.
    name : str, optional
        Name in results. By default, the key in ``contacts=``, or the number in a list.

    Raises
    ------
    ModelError
        If a restitution lies outside [0, 1], a coefficient is negative, or friction has no slip.

    Notes
    -----
    While the contact rests, the gap is a constraint with a normal force >= 0. Impacts that follow
    each other ever faster end in rest. Impulses have no friction.

    Examples
    --------
    >>> import symsimpson as ss
    >>> (z,) = ss.coordinates("z")
    >>> ball = ss.MechanicalSystem("ball", coordinates=(z,), kinetic=z.diff()**2/2, potential=10*z,
    ...                            contacts={"floor": ss.Contact(z, restitution=0.5)})
    >>> run = ss.compile(ball).integrate([1.0], v0=[0.0], h=0.01, t_end=2)
    >>> run.modes.names, run.modes.states[-1], float(run.events("floor").t[-1].round(9))
    (('floor',), ('rest',), 1.341640786)
    """

    gap: Any
    restitution: Any = field(default=0, kw_only=True)
    friction: Any = field(default=None, kw_only=True)
    slip: Any = field(default=None, kw_only=True)
    static: Any = field(default=None, kw_only=True)
    name: str | None = field(default=None, kw_only=True)

    def __post_init__(self) -> None:
        if not isinstance(self.gap, sp.Expr):
            reject(
                f"the gap of a contact is {spell(self.gap)!r}, not an expression.",
                remedy="Write a distance: Contact(y - R).",
                error=ModelError,
            )
        number = _number(self.restitution)
        unknown = number is None and not isinstance(self.restitution, sp.Expr)
        if unknown or (number is not None and not 0 <= number <= 1):
            reject(
                f"the restitution of a contact is {self.restitution!r}, but must be between "
                "0 (plastic) and 1 (elastic).",
                remedy="Pass restitution=0.5.",
                error=ModelError,
            )
        if self.friction is not None and self.slip is None:
            reject(
                "a contact has friction, but no slip.",
                remedy="Name the velocity with which it slides: slip=x.diff() - R*th.diff().",
                error=ModelError,
            )
        if self.friction is None and not (self.slip is None and self.static is None):
            reject(
                "a contact has slip or static, but no friction.",
                remedy="Pass Coulomb's coefficient: friction=0.3.",
                error=ModelError,
            )
        if self.friction is not None:
            _check_velocity(self.slip, "Contact")
            _check_limits("the coefficient of friction", self.friction, self.static)


def _number(given: Any) -> float | None:
    """Return a number as a float, and None for any other expression."""
    try:
        value = sp.sympify(given, strict=True)
    except (sp.SympifyError, TypeError, AttributeError):
        return None
    return float(value) if value.is_number and value.is_real else None


def _check_velocity(given: Any, what: str) -> None:
    if isinstance(given, (tuple, list, sp.MatrixBase)):
        reject(
            f"{what} has several velocities of sliding.",
            why="Friction in space, whose limit is a circle, is not available.",
            remedy="Pass one velocity. The motion is then in the plane.",
            error=ModelError,
        )
    if not isinstance(given, sp.Expr) or not given.has(sp.Derivative):
        reject(
            f"{what} slides with {spell(given)!r}, which contains no velocity.",
            remedy="Write a relative velocity: x.diff() - v_belt.",
            error=ModelError,
        )


def _check_limits(what: str, limit: Any, static: Any) -> None:
    """Reject limits that are no expressions, negative, or smaller in sticking."""
    for given in (limit,) if static is None else (limit, static):
        number = _number(given)
        if number is None and not isinstance(given, sp.Expr):
            reject(
                f"{what} is {spell(given)!r}, neither a number nor an expression.",
                remedy="Pass a number that is not negative.",
                error=ModelError,
            )
        if number is not None and not number >= 0:
            reject(
                f"{what} is {given}, but must not be negative.",
                remedy="Friction acts against the velocity: give its size.",
                error=ModelError,
            )
        if isinstance(given, sp.Expr) and given.has(sp.Derivative):
            reject(
                f"{what} {spell(given)} contains a velocity.",
                remedy="Write it with symsimpson.slip, the speed of sliding.",
                error=ModelError,
            )
    at_rest, held = _number(sp.sympify(limit).subs(slip, 0)), _number(static)
    if at_rest is not None and held is not None and held < at_rest:
        reject(
            f"static is {static}, less than {what} in sliding, {limit}.",
            remedy="Friction that sticks carries at least as much as friction that slides.",
            error=ModelError,
        )


def read_elements(name: str, contacts: Any, friction: Any) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the contacts and the friction elements of a system by name."""
    touching = name_elements(name, contacts, Contact)
    return touching, name_elements(name, friction, Friction, tuple(touching))


def name_elements(
    name: str, given: Any, kind: type[Any], taken: Sequence[str] = ()
) -> dict[str, Any]:
    """Return contacts or friction elements by name; entries of a list may have numbers as names."""
    what, word = ("contacts", "Contact") if kind is Contact else ("friction", "Friction")
    if given is None:
        return {}
    if isinstance(given, kind):
        given = (given,)
    if isinstance(given, Mapping):
        pairs = [(key, entry) for key, entry in given.items()]
    elif isinstance(given, Sequence) and not isinstance(given, str):
        pairs = [(getattr(x, "name", None) or str(k), x) for k, x in enumerate(given, 1)]
    else:
        pairs = [("", given)]
    named: dict[str, Any] = {}
    for key, entry in pairs:
        if not isinstance(entry, kind):
            reject_model(
                name,
                f"{what} contains {spell(entry)!r}, which is not a {word}.",
                f"Write {what}={{'floor': symsimpson.{word}(...)}}.",
            )
        if not isinstance(key, str) or not key.strip() or not key.isprintable():
            reject_model(
                name,
                f"the name {key!r} in {what} is not a printable string.",
                f"Write {what}={{'floor': symsimpson.{word}(...)}}.",
            )
        if key in named or key in taken or entry.name not in (None, key):
            reject_model(
                name,
                f"two contacts or friction elements have the name {key!r}, or one has two names.",
                "Give each its own name.",
            )
        named[key] = entry
    return named
