"""Initial states with constraints: check them, and project q0 onto the constraints."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from symsimpson.errors import InputError, ModelError, reject
from symsimpson.program.evaluation import evaluate
from symsimpson.program.program import Program
from symsimpson.support.array_types import Reals
from symsimpson.support.lengths import bending_length
from symsimpson.support.names import constraint_called
from symsimpson.text.quantity import slopes_of

#: Largest accepted violation of a constraint, relative to its gradient and to q. Velocity
#: constraints use v, or the speed that the forces produce from rest.
LARGEST_VIOLATION = 1e-9
#: Smallest size of a coordinate, relative to the largest coordinate.
SMALLEST_RELATIVE_SIZE = 1e-4
#: Constraints are dependent if INDEPENDENCE, between 0 and 1, is below this.
DEPENDENT = 1e-10
#: Most Newton iterations from a q0 that is accepted, in multiprecision as well.
MOST_ITERATIONS = 12
#: A constraint is flat if its gradient doubles over this change of q, relative to q. The change
#: exceeds the largest violation that is accepted.
FLAT_CHANGE = 4 * LARGEST_VIOLATION
#: Round-off of a constraint whose terms cancel, in units of machine epsilon.
ROUND_OFF = 1e4
#: Round-off of cancelling terms that are large relative to q, in units of machine epsilon.
CANCELLATION = 16.0


def project_start(
    program: Program,
    q: Reals,
    other: Reals,
    kind: str,
    values: Reals,
    t: Any,
    missed: float = LARGEST_VIOLATION,
    h: Any = 0.0,
) -> tuple[Reals, Reals]:
    """Project q0 onto the constraints by Newton's method; check v0 or p0 and return it unchanged.

    The arrays ``q``, ``other`` and ``values`` have one row for each ensemble member. ``kind`` is
    "v0" if ``other`` has velocities, "p0" for momenta, and "" to skip the check of ``other``.
    ``missed`` is the largest accepted violation, relative to the gradients and to q. For positions
    near the origin, the motion of one step ``h`` from rest counts as their size.

    Raises
    ------
    ModelError
        If the constraints are linearly dependent at q0.
    InputError
        If q0, v0 or p0 violates the constraints, or Newton's method does not converge.
    """
    numbers, header, n = program.numbers, program.header, program.n
    m = len(header.constraints)
    if not m:
        return q, other
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
    accelerations = at("HELD_RIGHT", n + m, rest)[:, list(header.tables["HELD_PLACE"][:n])]
    pulled = np.abs(accelerations.astype(np.float64)).max(axis=1)
    weight = at("CONSTRAINT_WEIGHT", m, rest).astype(np.float64) * size
    held = _relative(np.abs(at("MULTIPLIER", m, rest).astype(np.float64)), weight).max(axis=1)
    of_step = np.maximum(*(np.nan_to_num(x, posinf=0.0) for x in (pulled, held))) * float(h) ** 2
    reach = np.maximum(extents.max(axis=1), of_step)[:, None]
    whole, sizes = size * reach, _sizes(q, reach)
    typical = _scaled(slopes, sizes)
    ahead = np.where(q < 0, -1.0, 1.0) * FLAT_CHANGE
    flat = np.linalg.norm(slopes_at(q + ahead * reach) - slopes, axis=2) > size
    if flat.any():  # far from the origin, q is larger than its part in the constraint
        flat &= _scaled(slopes_at(q + ahead * sizes) - slopes, sizes) > typical
    flat |= size == 0
    _check_rank(program, q, slopes, flat, at("INDEPENDENCE", 1, rest)[:, 0])

    def missed_by(phi: Reals, noise: Reals | float = 0.0, scale: Reals = whole) -> Reals:
        return _relative(np.abs(phi.astype(np.float64)) - noise, scale)

    def rounded(lengths: Reals) -> Reals:
        noise: Reals = CANCELLATION * numbers.epsilon * size * lengths
        return noise

    scale = np.minimum(typical, whole) if kind else whole
    coordinate_scale = np.minimum(_scaled(slopes, extents), scale) if kind else whole
    for attempt in range(MOST_ITERATIONS):
        phi = at("CONSTRAINT", m, rest)
        off = missed_by(phi)
        if off.max() <= 4 * numbers.epsilon:
            break
        if attempt == 0 and not missed_by(phi, scale=coordinate_scale).max() <= missed:
            lengths = bending_length(slopes_at, q)
            if kind:
                bent = np.where(lengths > 0, lengths, np.inf)[..., None]
                bent = np.maximum(np.minimum(sizes[:, None], bent), extents[:, None])
                scale = np.minimum(scale, (np.abs(slopes) * bent).sum(axis=2))
            off = missed_by(phi, rounded(lengths), scale)
            if not off.max() <= missed:
                raise _violation_error(program, t, q, other, kind, values, off, "q0 violates")
        q = q + at("HELD_CHANGE", n, rest)
    else:
        off = missed_by(phi, rounded(bending_length(slopes_at, q)))
        if not off.max() <= max(missed**2, ROUND_OFF * numbers.epsilon):
            what = "Newton's method from q0 does not reach"
            raise _violation_error(program, t, q, other, kind, values, off, what)
    if not kind:
        return q, other
    speeds = other.astype(np.float64)
    # at a turning point v is only round-off: compare it with the speed that forces produce over q
    gained = np.sqrt(np.nan_to_num(pulled[:, None] * reach))
    fastest = np.abs(speeds).max(axis=1)[:, None]
    if kind == "v0":
        required = at("CURVATURE", m, rest, "start").astype(np.float64)
        violation = (slopes @ speeds[..., None])[..., 0] - required
        most = np.maximum(fastest, gained)
        scale = np.minimum(_scaled(slopes, _sizes(speeds, most)), size * most)
    else:  # the projection removes a part of p without effect, but the user surely meant it
        multipliers = at("MULTIPLIER", m, other, "start").astype(np.float64)
        violation = multipliers * size**2
        gained = gained * at("CONSTRAINT_WEIGHT", m, rest).astype(np.float64) * size**2  # by M
        scale = size * np.maximum(fastest, gained)
    off = _relative(np.abs(violation), scale)
    if not off.max() <= missed:
        what = "v0 violates" if kind == "v0" else "p0 has a component along"
        raise _violation_error(program, t, q, other, kind, values, off, what)
    return q, other


def _sizes(x: Reals, most: Reals) -> Reals:
    """Return the sizes of coordinates or velocities, at least a fraction of the largest."""
    sizes: Reals = np.maximum(np.abs(x.astype(np.float64)), SMALLEST_RELATIVE_SIZE * most)
    return sizes


def _scaled(slopes: Reals, sizes: Reals) -> Reals:
    """Return the sum of |gradient| times size over the coordinates, one number a constraint."""
    terms: Reals = (np.abs(slopes) @ sizes[..., None])[..., 0]
    return terms


def _relative(miss: Reals, scale: Reals) -> Reals:
    """Return violations divided by ``scale``: infinite if only the scale is zero, 0 if both are."""
    miss = np.maximum(miss, 0.0)
    off: Reals = np.where(miss > 0, np.inf, 0.0)
    np.divide(miss, scale, out=off, where=(scale > 0) & (miss != 0))
    return off


def _check_rank(
    program: Program, q: Reals, slopes: Reals, flat: NDArray[np.bool_], independence: Reals
) -> None:
    """Reject q0 if gradients of constraints are not finite, zero or linearly dependent."""
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
            f"the gradient of a constraint is not finite at {where}.",
            where=program.system,
            remedy="Start from another position.",
        )
    if none.any():
        which = ", ".join(constraint_called(names[c]) for c in np.flatnonzero(none))
        if none[len(rows) - rolling :].any():
            reject(
                f"all velocity coefficients of the constraint {which} are zero at {where}.",
                where=program.system,
                why="The constraint force then has no direction.",
                remedy="Start from another position, or check the parameters in the constraint.",
                error=ModelError,
            )
        reject(
            f"the gradient of the constraint {which} is zero at {where}.",
            where=program.system,
            why="The constraint force then has no direction.",
            remedy="Write phi with a nonzero gradient where phi = 0. For example, write "
            "x**2 + y**2 - 1 and not its square.",
            error=ModelError,
        )
    reject(
        f"the constraints {name_dependent(names, rows)} are linearly dependent at {where}.",
        where=program.system,
        why="One of them follows from the others, so the constraint forces are not determined.",
        remedy="If they depend on each other everywhere, remove one. If the mechanism is only "
        "folded at this position, start from another one.",
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
    kind: str,
    values: Reals,
    off: Reals,
    what: str,
) -> InputError:
    """Make the error that names the worst violation and suggests a consistent start."""
    worst = np.nan_to_num(off, nan=np.inf)
    member, c = np.unravel_index(int(np.argmax(worst)), off.shape)
    name = program.names.constraints.shown[int(c)]
    which = f" of member {member}" if len(q) > 1 else ""
    text = (
        f"{program.system}: {what} the constraint {constraint_called(name)}{which}. "
        f"The error is {off[member, c]:.2g}, relative to its gradient and the size of the state."
    )
    system = program.declared
    if system is None:
        return InputError(f"{text}\nPass a start with phi = 0, dphi/dq.v = -dphi/dt and A v = b.")
    parameters = dict(zip(program.parameters, map(float, values[member]), strict=True))
    usual = map(float, system.parameters.values())
    other_values = {
        name: value
        for (name, value), default in zip(parameters.items(), usual, strict=True)
        if value != default
    }
    arguments = f", parameters={other_values}" if other_values else ""
    call = f"system.consistent(q0, v0{arguments}" + (
        f", t={float(t)!r})" if t and system.plain.carried else ")"
    )
    try:
        velocities = other[member] if kind == "v0" else 0 * other[member]
        near = system.consistent(
            q[member].astype(np.float64), velocities.astype(np.float64), (), parameters, float(t)
        )
        rounded = [[float(f"{number:.6g}") for number in x] for x in near]
        shown = f"q0={rounded[0]}, v0={rounded[1]}"
        text += f"\n{call} returns the nearest start" + (f": {shown}." if kind == "v0" else ".")
    except InputError:
        text += f"\n{call} finds no consistent start nearby."
    return InputError(text + (" Or pass v0 instead of p0." if kind == "p0" else ""))
