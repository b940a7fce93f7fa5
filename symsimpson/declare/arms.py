"""Serial arms: T and V, computed link by link from Denavit-Hartenberg parameters."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import sympy as sp
from numpy.typing import NDArray

from symsimpson.declare.checks import read_name, reject_model, spell
from symsimpson.declare.coordinates import coordinates
from symsimpson.declare.system import MechanicalSystem

#: Three expressions, or three rows of them, as objects of NumPy.
Vector = NDArray[Any]
#: A float this close to a multiple of pi/2 counts as that multiple.
CLOSE = 1e-12


@dataclass(frozen=True)
class Link:
    """A link of a serial arm and the joint before it.

    All quantities are numbers or SymPy expressions, in one consistent system of units. Every
    default is 0.

    Parameters
    ----------
    a, alpha, d, theta : number or expression
        Denavit-Hartenberg parameters: length, twist, offset and angle. The coordinate of the
        joint is added to ``theta`` if the joint is revolute, and to ``d`` if it is prismatic.
    mass : number or expression
        The mass of the link.
    centre : three numbers or expressions
        The centre of mass in the frame of the link.
    inertia : three or six numbers or expressions
        Moments of inertia about the centre in the frame of the link: xx, yy, zz and, if they are
        not zero, xy, yz, xz.
    rotor : number or expression
        The inertia of the motor at the joint: the square of the gear ratio times its own inertia.
    prismatic : bool
        Whether the joint slides along its axis instead of turning about it. Default False.

    Examples
    --------
    >>> import symsimpson as ss
    >>> ss.Link(a=0.5, mass=2.0).prismatic
    False
    """

    a: Any = 0
    alpha: Any = 0
    d: Any = 0
    theta: Any = 0
    mass: Any = 0
    centre: Sequence[Any] = (0, 0, 0)
    inertia: Sequence[Any] = (0, 0, 0)
    rotor: Any = 0
    prismatic: bool = False


def serial_arm(
    name: str,
    links: Sequence[Link],
    *,
    gravity: Sequence[Any] = (0, 0, -9.81),
    modified: bool = False,
    parameters: Mapping[sp.Symbol, float] | None = None,
    joints: str | None = None,
) -> MechanicalSystem:
    """Declare a serial arm by its links.

    Parameters
    ----------
    name : str
        The name of the system.
    links : sequence of Link
        The links from the base to the tool.
    gravity : three numbers or expressions
        The acceleration of gravity in the frame of the base. The default is (0, 0, -9.81).
    modified : bool, default False
        Whether the parameters follow the modified convention (Craig), in which ``a`` and
        ``alpha`` of a link come before its joint. In the standard convention (Denavit and
        Hartenberg [1]_) they come after it.
    parameters : mapping from symbol to number, optional
        Values of the symbols in links and gravity.
    joints : str, optional
        Names of the coordinates. The default is q1, q2, ...

    Returns
    -------
    MechanicalSystem
        The arm, with its joints and its tool as positions to draw.

    Raises
    ------
    ModelError
        If there is no link, or a vector has the wrong number of entries. All errors of
        MechanicalSystem are also possible.

    Notes
    -----
    Velocities are expressed in the frame of each link, from the velocities of the previous
    link (Luh, Walker and Paul [2]_). The length of T is therefore proportional to the number of
    links.

    References
    ----------
    .. [1] J. Denavit, R. S. Hartenberg, A kinematic notation for lower-pair mechanisms based on
       matrices, ASME Journal of Applied Mechanics 22 (1955), 215-221.
    .. [2] J. Y. S. Luh, M. W. Walker, R. P. C. Paul, On-line computational scheme for mechanical
       manipulators, ASME Journal of Dynamic Systems, Measurement and Control 102 (1980), 69-76.

    Examples
    --------
    >>> import symsimpson as ss
    >>> bar = ss.Link(a=0.5, mass=2.0, centre=(-0.25, 0, 0), inertia=(0, 0.04, 0.04))
    >>> arm = ss.serial_arm("two_bars", [bar, bar], gravity=(0, -9.81, 0))
    >>> arm.n, arm.structure.periodic
    (2, ('q1', 'q2'))
    """
    name = read_name(name)
    count = len(links) if isinstance(links, Sequence) else 0
    q = coordinates(joints or f"q1:{count + 1}") if count else ()
    kinetic, potential, positions = arm_energies(name, links, q, gravity, modified=modified)
    return MechanicalSystem(
        name,
        coordinates=q,
        kinetic=kinetic,
        potential=potential,
        parameters=parameters or {},
        positions=positions,
    )


def arm_energies(
    name: str,
    links: Sequence[Link],
    q: Sequence[Any],
    gravity: Sequence[Any] = (0, 0, -9.81),
    *,
    modified: bool = False,
) -> tuple[sp.Expr, sp.Expr, dict[str, tuple[Any, ...]]]:
    """Return T, V and the points to draw of a serial arm, for a system with further terms."""
    reject_here = partial(reject_model, name)
    if not isinstance(links, Sequence) or not all(isinstance(link, Link) for link in links):
        reject_here(
            f"the links are {spell(links)}, not a sequence of symsimpson.Link.",
            "Write links=[ss.Link(a=0.5, mass=2.0, inertia=(0, 0.04, 0.04)), ...].",
        )
    for link in links:
        for what in ("a", "alpha", "d", "theta", "mass", "rotor"):
            _entries(name, f"a link's {what}", (getattr(link, what),))
    if not links or len(links) != len(q):
        reject_here(
            f"it has {len(links)} links and {len(q)} joints.",
            "Declare one link after each joint, and at least one.",
        )
    zero = np.full(3, sp.S.Zero)
    omega, velocity, origin, height = zero, zero, zero, sp.S.Zero
    pull = _vector(name, "gravity", gravity)
    frame = np.eye(3, dtype=int).astype(object)
    terms: list[sp.Expr] = []
    weights: list[sp.Expr] = []
    points = [origin]
    for link, x in zip(links, q, strict=True):
        rotation, shift, axis = _joint(link, x, modified=modified)
        turn, slide = (sp.S.Zero, x.diff()) if link.prismatic else (x.diff(), sp.S.Zero)
        origin = origin + frame @ shift
        frame = frame @ rotation
        points.append(origin)
        height -= pull @ shift
        before = omega
        omega = omega + turn * axis
        # in the modified convention the axis contains the origin of the link
        lever = before if modified else omega
        velocity = velocity + np.cross(lever, shift) + slide * axis
        # components in the frame of the link
        omega, velocity, pull = (rotation.T @ y for y in (omega, velocity, pull))
        centre = _vector(name, "a link's centre", link.centre)
        v = velocity + np.cross(omega, centre)
        terms += [
            link.mass * (v @ v),
            _rotational_energy(name, link, omega),
            link.rotor * x.diff() ** 2,
        ]
        weights.append(link.mass * (height - pull @ centre))
    names = ["base", *(f"joint {k}" for k in range(2, len(links) + 1)), "tool"]
    return sp.Add(*terms) / 2, sp.Add(*weights), dict(zip(names, map(tuple, points), strict=True))


def _joint(link: Link, x: Any, *, modified: bool) -> tuple[Vector, ...]:
    """Return the rotation, shift and axis of a joint in the frame of the previous link."""
    theta, d = (link.theta, link.d + x) if link.prismatic else (link.theta + x, link.d)
    (c, s), (ca, sa) = map(_cosine_and_sine, (theta, link.alpha))
    if modified:
        rotation = (c, -s, 0), (s * ca, c * ca, -sa), (s * sa, c * sa, ca)
        shift, axis = (link.a, -d * sa, d * ca), (0, -sa, ca)
    else:
        rotation = (c, -s * ca, s * sa), (s, c * ca, -c * sa), (0, sa, ca)
        shift, axis = (link.a * c, link.a * s, d), (0, 0, 1)
    return tuple(np.array(x, dtype=object) for x in (rotation, shift, axis))


def _rotational_energy(name: str, link: Link, omega: Vector) -> sp.Expr:
    """Return omega.I.omega, twice the energy."""
    inertia = _entries(name, "a link's inertia", link.inertia)
    if len(inertia) not in (3, 6):
        reject_model(
            name,
            f"a link's inertia has {len(inertia)} entries.",
            "Pass xx, yy, zz, or xx, yy, zz, xy, yz, xz.",
        )
    xx, yy, zz, xy, yz, xz = (*inertia, 0, 0, 0)[:6]
    x, y, z = omega
    squares = xx * x**2 + yy * y**2 + zz * z**2
    return squares + 2 * (xy * x * y + yz * y * z + xz * x * z)


def _vector(name: str, what: str, given: Sequence[Any]) -> Vector:
    """Check that a vector has three entries."""
    entries = _entries(name, what, given)
    if len(entries) != 3:
        reject_model(name, f"{what} has {len(entries)} entries.", "Pass x, y and z.")
    return np.array(entries, dtype=object)


def _entries(name: str, what: str, given: Any) -> tuple[Any, ...]:
    """Check that the entries of a vector are numbers or expressions."""
    try:
        entries = tuple(given)
        for entry in entries:
            sp.sympify(entry, strict=True)
    except (TypeError, sp.SympifyError):
        reject_model(name, f"{what} is {spell(given)!r}.", "Pass numbers or SymPy expressions.")
    return entries


def _cosine_and_sine(angle: Any) -> tuple[Any, Any]:
    """Return cosine and sine, which are integers for floats near multiples of pi/2."""
    if isinstance(angle, (int, float)):
        quarters = round(2 * angle / math.pi)
        if abs(angle - quarters * math.pi / 2) < CLOSE:
            return ((1, 0), (0, 1), (-1, 0), (0, -1))[quarters % 4]
    cosine, sine = sp.cos(angle), sp.sin(angle)
    return cosine if cosine != 0 else sp.S.Zero, sine if sine != 0 else sp.S.Zero
