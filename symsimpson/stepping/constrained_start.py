"""Starts of systems with constraints: checked, and brought onto them to rounding."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from symsimpson.errors import InputError, ModelError, reject
from symsimpson.program.observed import evaluate
from symsimpson.program.program import Program
from symsimpson.support.array_types import Reals
from symsimpson.support.lengths import bending_length
from symsimpson.support.names import constraint_called
from symsimpson.text.quantity import slopes_of

#: Starts that miss constraints by more than this, relative to their slopes and to q, are refused,
#: whatever the unit of q. Velocities are held against v, or what the forces make of rest. Each
#: coordinate has its own size, or this part of the largest one, if a constraint bends no earlier.
MISSED, OTHERS = 1e-9, 1e-4
#: Constraints are dependent where INDEPENDENCE, between 0 and 1, is below this.
DEPENDENT = 1e-10
#: Newton's method from a start that misses by less needs so many iterations, with many digits too.
MOST = 12
#: A constraint is flat whose slope is made of what q misses it by: it doubles over so much of q,
#: which is more than a start may miss by.
FLAT = 4 * MISSED
#: What rounding leaves of a constraint, in units of it, where terms cancel.
ROUNDED = 1e4
#: What rounding leaves of terms that are large against q, in units of it, where they cancel.
CANCELLED = 16.0


def project_start(
    program: Program,
    q: Reals,
    other: Reals,
    given: str,
    values: Reals,
    t: Any,
    missed: float = MISSED,
) -> tuple[Reals, Reals]:
    """Correct q0 onto the constraints by Newton's method; check v0 or p0, unchanged.

    Positions, velocities or momenta, and values of parameters have a row for each member; ``given``
    says what the second are, "" if they are not to be looked at. By ``missed`` a start may miss the
    constraints, relative to their slopes and to q.

    Raises
    ------
    ModelError
        If constraints depend on each other there.
    InputError
        If q does not satisfy them and is not led there, or velocities are not allowed by them.
    """
    numbers, held = program.numbers, program.header.constraints
    if not held:
        return q, other
    m, n, header = len(held), program.n, program.header
    times = numbers.read([t])

    def at(
        block: str, count: int, p: Reals, kernel: str = "multipliers", places: Reals | None = None
    ) -> Reals:
        here = q if places is None else places
        return evaluate(program, kernel, block, count, (times, here, p), values)

    def slopes_at(places: Reals) -> Reals:
        rows = at("CONSTRAINT_QQ", header.layout["HELD_SIZE"], rest, places=places)
        return slopes_of(header, rows.astype(np.float64))

    rest = 0 * q
    slopes = slopes_at(q)
    size = np.linalg.norm(slopes, axis=2)
    extents = np.abs(q.astype(np.float64))
    reach = extents.max(axis=1)[:, None]
    whole, sizes = size * reach, _sizes(q, reach)
    met = _scaled(slopes, sizes)
    ahead = np.where(q < 0, -1.0, 1.0) * FLAT
    flat = np.linalg.norm(slopes_at(q + ahead * reach) - slopes, axis=2) > size
    if flat.any():  # far from the origin positions have other sizes than what depends on them
        flat &= _scaled(slopes_at(q + ahead * sizes) - slopes, sizes) > met
    flat |= size == 0
    _check_rank(program, q, slopes, flat, at("INDEPENDENCE", 1, rest)[:, 0])

    def missed_by(phi: Reals, noise: Reals | float = 0.0, scale: Reals = whole) -> Reals:
        return _relative(np.abs(phi.astype(np.float64)) - noise, scale)

    def rounded(lengths: Reals) -> Reals:
        noise: Reals = CANCELLED * numbers.epsilon * size * lengths
        return noise

    scale = np.minimum(met, whole) if given else whole
    alone = np.minimum(_scaled(slopes, extents), scale) if given else whole
    for attempt in range(MOST):
        phi = at("CONSTRAINT", m, rest)
        off = missed_by(phi)
        if off.max() <= 4 * numbers.epsilon:
            break
        if attempt == 0 and not missed_by(phi, scale=alone).max() <= missed:
            lengths = bending_length(slopes_at, q)
            if given:
                bent = np.where(lengths > 0, lengths, np.inf)[..., None]
                bent = np.maximum(np.minimum(sizes[:, None], bent), extents[:, None])
                scale = np.minimum(scale, (np.abs(slopes) * bent).sum(axis=2))
            off = missed_by(phi, rounded(lengths), scale)
            if not off.max() <= missed:
                raise _violation_error(
                    program, t, q, other, given, values, off, "q0 does not satisfy"
                )
        q = q + at("HELD_CHANGE", n, rest)
    else:
        off = missed_by(phi, rounded(bending_length(slopes_at, q)))
        if not off.max() <= max(missed**2, ROUNDED * numbers.epsilon):
            raise _violation_error(program, t, q, other, given, values, off, "q0 is not led to")
    if not given:
        return q, other
    speeds = other.astype(np.float64)
    pulled = np.abs(at("VELOCITY", n, rest).astype(np.float64)).max(axis=1)
    # where the motion turns, v is a rounding: it is held against what an acceleration gains on q
    gained = np.sqrt(np.nan_to_num(pulled[:, None] * reach))
    fastest = np.abs(speeds).max(axis=1)[:, None]
    if given == "v0":
        asked = at("CURVATURE", m, rest, "start").astype(np.float64)
        taken = (slopes @ speeds[..., None])[..., 0] - asked
        most = np.maximum(fastest, gained)
        scale = np.minimum(_scaled(slopes, _sizes(speeds, most)), size * most)
    else:  # what the constraints take from p is of no effect, but was surely meant otherwise
        pulls = at("MULTIPLIER", m, other, "start").astype(np.float64)
        taken = pulls * size**2
        gained = gained * at("CONSTRAINT_WEIGHT", m, rest).astype(np.float64) * size**2  # by M
        scale = size * np.maximum(fastest, gained)
    off = _relative(np.abs(taken), scale)
    if not off.max() <= missed:
        what = "v0 is not allowed by" if given == "v0" else "p0 has a part that is taken by"
        raise _violation_error(program, t, q, other, given, values, off, what)
    return q, other


def _sizes(x: Reals, most: Reals) -> Reals:
    """Return the sizes of coordinates or velocities, which may have units of their own."""
    sizes: Reals = np.maximum(np.abs(x.astype(np.float64)), OTHERS * most)
    return sizes


def _scaled(slopes: Reals, sizes: Reals) -> Reals:
    """Return how large slopes are in units of what they multiply."""
    terms: Reals = (np.abs(slopes) @ sizes[..., None])[..., 0]
    return terms


def _relative(miss: Reals, scale: Reals) -> Reals:
    """Return what constraints are missed by in units of their slopes and of a state.

    It is 0 where nothing is missed, and infinite where the state is zero and misses something.
    """
    miss = np.maximum(miss, 0.0)
    off: Reals = np.where(miss > 0, np.inf, 0.0)
    np.divide(miss, scale, out=off, where=(scale > 0) & (miss != 0))
    return off


def _check_rank(
    program: Program, q: Reals, slopes: Reals, flat: NDArray[np.bool_], independence: Reals
) -> None:
    """Refuse a start where gradients of constraints are not finite, zero or dependent."""
    finite = np.isfinite(slopes).all()
    worst = int(np.argmin(np.where(flat.any(axis=1), 0.0, independence.astype(np.float64))))
    if finite and independence[worst] >= DEPENDENT and not flat.any():
        return
    names = program.names.constraints.shown
    rolling = len(program.header.velocity_constraints)
    rows, none = slopes[worst], flat[worst]
    where = f"q0={[float(x) for x in q[worst]]}"
    if not np.isfinite(rows).all():
        reject(
            f"{program.system}: constraints have no finite slope at {where}.",
            remedy="Begin elsewhere.",
        )
    if none.any():
        which = ", ".join(constraint_called(names[c]) for c in np.flatnonzero(none))
        if none[len(rows) - rolling :].any():
            reject(
                f"{program.system}: the constraint {which} asks for nothing at {where}: all its "
                "factors of velocities are zero there, so its force has no direction.",
                remedy="Begin elsewhere, or look at the parameters in it.",
                error=ModelError,
            )
        reject(
            f"{program.system}: the constraint {which} has no slope at {where}: its gradient is "
            "zero there, so the constraint force has no direction.",
            remedy="Write phi so that its gradient "
            "does not vanish where phi = 0, as x**2 + y**2 - 1 and not its square.",
            error=ModelError,
        )
    reject(
        f"{program.system}: the constraints {name_dependent(names, rows)} depend on each other at "
        f"{where}.",
        remedy="One of them follows from the others there, so the constraint forces are not "
        "determined. If this holds everywhere, leave one out; if the mechanism is folded there, "
        "begin elsewhere.",
        error=ModelError,
    )


def name_dependent(names: Sequence[str], slopes: Reals) -> str:
    """List, as text, the constraints whose gradients are linearly dependent."""
    size = np.linalg.norm(slopes, axis=1)
    combination = np.linalg.svd(slopes / np.where(size > 0, size, 1.0)[:, None])[0][:, -1]
    which = np.flatnonzero(np.abs(combination) > 1e-3).tolist()
    return ", ".join(constraint_called(names[c]) for c in which)


def _violation_error(
    program: Program,
    t: Any,
    q: Reals,
    other: Reals,
    given: str,
    values: Reals,
    off: Reals,
    what: str,
) -> InputError:
    """Return the error that names the worst violation and suggests a consistent start."""
    worst = np.nan_to_num(off, nan=np.inf)
    member, c = np.unravel_index(int(np.argmax(worst)), off.shape)
    name = program.names.constraints.shown[int(c)]
    which = f" of member {member}" if len(q) > 1 else ""
    text = (
        f"{program.system}: {what} the constraint {constraint_called(name)}{which}: it is off by "
        f"{off[member, c]:.2g}, relative to its slope and the size of the state."
    )
    system = program.declared
    if system is None:
        return InputError(f"{text}\nGive a start with phi = 0, dphi/dq.v = 0 and A v = b.")
    parameters = dict(zip(program.parameters, map(float, values[member]), strict=True))
    usual = map(float, system.parameters.values())
    other_values = {
        name: value
        for (name, value), default in zip(parameters.items(), usual, strict=True)
        if value != default
    }
    more = f", parameters={other_values}" if other_values else ""
    call = f"system.consistent(q0, v0{more}" + (
        f", t={float(t)!r})" if t and system.velocity_constraints else ")"
    )
    try:
        velocities = other[member] if given == "v0" else 0 * other[member]
        near = system.consistent(
            q[member].astype(np.float64), velocities.astype(np.float64), (), parameters, float(t)
        )
        rounded = [[float(f"{number:.6g}") for number in x] for x in near]
        shown = f"q0={rounded[0]}, v0={rounded[1]}"
        text += f"\n{call} gives the nearest start" + (f": {shown}." if given == "v0" else ".")
    except InputError:
        text += f"\n{call} finds none nearby."
    return InputError(text + (" Or give v0." if given == "p0" else ""))
