"""The choice of the next mode: which contacts rest, and which friction elements stick or slide."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from symsimpson.support.array_types import Floats
from symsimpson.support.contact_values import (
    Counts,
    IndexOne,
    Mode,
    ModeEquations,
    rows_of_mode,
    weighted_mass,
)

Truths = NDArray[np.bool_]
#: Relative round-off of conditions at a state.
TOLERANCE = 1e-9
#: Rows are dependent if the smallest eigenvalue of their scaled matrix is below this.
DEPENDENT = 1e-10
#: Largest number of modes that are tried at a state.
MOST_TRIED = 4**6


class ModeMotion(NamedTuple):
    """Accelerations and multipliers of a mode at a state."""

    acceleration: Floats
    normal: Floats  #: Normal force of each contact, 0 while it is open.
    friction: Floats  #: Multiplier nu of each element: the force is -nu du/dv.
    size: Floats  #: Bounds of the terms of the accelerations.
    forces: tuple[Floats, Floats]  #: Bounds of the terms of normal forces and of friction.
    margin: float  #: Determinant of the equations, relative to that without sliding friction.


@dataclass
class StateOfContacts:
    """Contacts and friction elements at one state (q, v).

    ``at`` has the equations there, and ``contact_of`` the contact of each element, or None. ``h``
    is the step size. ``left`` has contacts and elements that have just left their bounds: (True,
    contact) may not rest, and (False, element) may not stick.
    """

    at: IndexOne
    counts: Counts
    contact_of: Sequence[int | None]
    q: Floats
    v: Floats
    h: float
    left: frozenset[tuple[bool, int]] = field(default=frozenset())
    #: Bounds of the terms of the forces, which may cancel.
    terms: Floats | None = None

    def __post_init__(self) -> None:
        at, h = self.at, abs(self.h)
        self._inverse = np.linalg.inv(weighted_mass(at, self.counts)[0])
        spread = np.abs(self._inverse)
        W = np.abs(at.W)
        self._push = push = np.abs(at.push) if self.terms is None else self.terms
        of_elements = zip(self.counts.element_rows, self.contact_of, at.limits, strict=False)
        for r, contact, limit in of_elements:  # friction counts where no other force acts
            load = 1.0
            if contact is not None:
                c = self.counts.contact_rows[contact]
                mobility = abs(at.W[c] @ self._inverse @ at.W[c])
                load = float(W[c] @ spread @ self._push) / float(mobility or 1.0)
            push = push + abs(limit) * load * W[r]
        speeds = np.abs(self.v) + spread @ push * h
        side = np.abs(at.W @ self.v - at.rates)
        #: Bounds of the terms of rates and gaps.
        self.rate_sizes = W @ speeds + side
        rows = self.counts.contact_rows
        self.gap_sizes = W[rows.start : rows.stop] @ (np.abs(self.q) + speeds * h)

    @property
    def contact_rates(self) -> Floats:
        """Rates of the gaps."""
        rows = self.counts.contact_rows
        return self.at.rates[rows.start : rows.stop]

    @property
    def sliding(self) -> Floats:
        """Velocities of sliding of the elements."""
        rows = self.counts.element_rows
        return self.at.rates[rows.start : rows.stop]

    @property
    def touching(self) -> Truths:
        """Whether each gap is zero up to round-off."""
        near: Truths = np.abs(self.at.gaps) <= TOLERANCE * self.gap_sizes
        return near

    def still(self, rows: range) -> Truths:
        """Return whether the rate of each row is zero up to round-off."""
        some = slice(rows.start, rows.stop)
        near: Truths = np.abs(self.at.rates[some]) <= TOLERANCE * self.rate_sizes[some]
        return near

    def with_directions(self, mode: Mode) -> Mode:
        """Return a mode in which elements slide as the velocities say, or keep their state."""
        still = self.still(self.counts.element_rows)
        elements: list[int | None] = []
        for k, (state, contact) in enumerate(zip(mode.elements, self.contact_of, strict=True)):
            if contact is not None and not mode.contacts[contact]:
                elements.append(None)
            elif not still[k]:
                elements.append(int(np.sign(self.sliding[k])))
            else:
                elements.append(state or 0)
        return Mode(mode.contacts, tuple(elements))

    def sliding_contacts(self, hit: Sequence[int]) -> list[int]:
        """Return the contacts among ``hit`` that have friction and slide."""
        still = self.still(self.counts.element_rows)
        pairs = enumerate(self.contact_of)
        return [c for k, c in pairs if c is not None and c in hit and not still[k]]

    def bad_limit(self) -> int | None:
        """Return an element whose limit is negative or not finite, or smaller in sticking."""
        sliding, static = np.split(self.at.limits, 2)
        fine = (sliding >= 0) & (static >= 0) & np.isfinite(sliding) & np.isfinite(static)
        # at rest, both limits belong to the same speed
        low = self.still(self.counts.element_rows) & (static < sliding * (1 - TOLERANCE))
        bad = np.flatnonzero(~fine | low)
        return int(bad[0]) if bad.size else None

    def rows_of(self, mode: Mode) -> list[int]:
        """Return the rows that hold in a mode."""
        return rows_of_mode(self.counts, mode)

    def motion(self, mode: Mode) -> ModeMotion | None:
        """Return the accelerations and multipliers of a mode; None if its rows are dependent."""
        at, counts, inverse = self.at, self.counts, self._inverse
        about = at, counts, mode, self.contact_of
        equations = ModeEquations.of(*about)
        rows, W, P, push, sizes = equations
        sizes = sizes + self._push - np.abs(at.push)
        spread, x, bound, margin = np.abs(inverse), np.zeros(0), np.zeros(0), 1.0
        if rows:
            straight, G = W @ inverse @ W.T, W @ inverse @ P.T
            scale = np.sqrt(np.diag(straight))
            if not (scale > 0).all():
                return None
            scaled = straight / np.outer(scale, scale)
            if not np.linalg.eigvalsh(scaled)[0] > DEPENDENT:
                return None
            sign = (-1) ** (len(rows) - sum(mode.contacts))
            whole = np.linalg.det(G / np.outer(scale, scale))
            margin = float(sign * whole / np.linalg.det(scaled))
            if margin == 0.0:
                return None
            solved, curve = np.linalg.inv(G), at.curve[rows]
            x = -solved @ (curve + W @ (inverse @ push))
            bound = np.abs(solved) @ (np.abs(curve) + np.abs(W) @ (spread @ sizes))
            push, sizes = push + P.T @ x, sizes + np.abs(P).T @ bound
        normal, friction = equations.forces(x, *about)
        bounds = equations.forces(bound, *about)
        return ModeMotion(inverse @ push, normal, friction, spread @ sizes, bounds, margin)

    def allows(self, mode: Mode, motion: ModeMotion | None) -> bool:
        """Return whether a mode satisfies all inequalities."""
        if motion is None or not motion.margin > TOLERANCE:
            return False
        at, counts = self.at, self.counts
        rates = at.W @ motion.acceleration + at.curve
        sizes = np.abs(at.W) @ motion.size + np.abs(at.curve)
        still = self.still(counts.contact_rows)
        for c, (r, rests) in enumerate(zip(counts.contact_rows, mode.contacts, strict=True)):
            if rests and motion.normal[c] < -TOLERANCE * motion.forces[0][c]:
                return False
            leaves = not rests and self.touching[c] and still[c]
            if leaves and rates[r] < -TOLERANCE * sizes[r]:
                return False
        static = np.split(at.limits, 2)[1]
        still = self.still(counts.element_rows)
        for k, (r, state) in enumerate(zip(counts.element_rows, mode.elements, strict=True)):
            contact = self.contact_of[k]
            presses = contact is None or mode.contacts[contact]
            if state is None and presses and not self._follows(r, mode):
                return False
            load = 1.0 if contact is None else motion.normal[contact]
            most = static[k] * load * (1 + TOLERANCE) + TOLERANCE * motion.forces[1][k]
            if state == 0 and abs(motion.friction[k]) > most:
                return False
            if state and still[k] and state * rates[r] < -TOLERANCE * sizes[r]:
                return False
        return True

    def choices(self) -> Iterator[Mode]:
        """Yield all modes that the positions and velocities of the state allow."""
        counts = self.counts
        contact_still, element_still = (
            self.still(counts.contact_rows),
            self.still(counts.element_rows),
        )
        touching, sliding = self.touching, self.sliding
        contacts = [
            (True, False) if touching[c] and contact_still[c] else (False,)
            for c in range(counts.gaps)
        ]
        contacts = [
            (False,) if (True, c) in self.left else given for c, given in enumerate(contacts)
        ]
        elements: list[tuple[int | None, ...]] = []
        for k in range(counts.elements):
            given = (0, None, 1, -1) if element_still[k] else (int(np.sign(sliding[k])),)
            elements.append(given[2:] if (False, k) in self.left and len(given) > 1 else given)
        for resting in product(*contacts):
            open_ = [c is not None and not resting[c] for c in self.contact_of]
            some: list[tuple[int | None, ...]] = [
                (None,) if off else given for off, given in zip(open_, elements, strict=True)
            ]
            for moving in product(*some):
                yield Mode(tuple(resting), tuple(moving))

    def number_of_choices(self) -> int:
        """Return an upper bound of the number of modes."""
        undecided = self.touching & self.still(self.counts.contact_rows)
        sticking = self.still(self.counts.element_rows)
        return int(2 ** int(undecided.sum()) * 4 ** int(sticking.sum()))

    def decide(self, first: Mode) -> tuple[Mode | None, bool]:
        """Return the next mode, or None, and whether others need as few changes.

        ``first`` is the mode that is expected: it is tried first, then the modes that differ from
        it least.
        """
        fits = any(first == mode for mode in self._some_choices())
        if fits and self.allows(first, self.motion(first)):
            return first, False
        if self.number_of_choices() > MOST_TRIED:
            return None, False
        chosen: Mode | None = None
        for mode in sorted(self.choices(), key=first.changes):
            if chosen is not None and first.changes(mode) > first.changes(chosen):
                break
            if self.allows(mode, self.motion(mode)):
                if chosen is not None:
                    return chosen, True
                chosen = mode
        return chosen, False

    def _some_choices(self) -> Iterator[Mode]:
        return self.choices() if self.number_of_choices() <= MOST_TRIED else iter(())

    def implied(self, mode: Mode) -> frozenset[int]:
        """Return the open contacts whose gaps stay zero, because other contacts rest."""
        still = self.still(self.counts.contact_rows)
        return frozenset(
            c
            for c, r in enumerate(self.counts.contact_rows)
            if not mode.contacts[c] and self.touching[c] and still[c] and self._follows(r, mode)
        )

    def _follows(self, row: int, mode: Mode) -> bool:
        """Return whether a row follows from the rows that hold in a mode."""
        rows = self.rows_of(mode)
        if not rows:
            return False
        held = self.at.W[[*rows, row]]
        whole = held @ self._inverse @ held.T
        scale = np.sqrt(np.diag(whole))
        return not np.linalg.eigvalsh(whole / np.outer(scale, scale))[0] > DEPENDENT

    def paradox(self, mode: Mode) -> bool:
        """Return whether an open contact could also rest and slide, without a normal force."""
        still = self.still(self.counts.contact_rows)
        for c in self.sliding_contacts(range(self.counts.gaps)):
            if self.touching[c] and still[c] and not mode.contacts[c]:
                motion = self.motion(self.with_directions(mode.with_contact(c, True)))
                if motion is not None and not motion.margin > TOLERANCE:
                    return True
        return False

    def nearest(self, mode: Mode) -> tuple[Floats, Floats]:
        """Return the least corrections of q and v, in M, after which the rows of a mode hold."""
        at, rows = self.at, self.rows_of(mode)
        if not rows:
            return 0 * self.q, 0 * self.v
        held = at.W[rows]
        back = self._inverse @ held.T @ _inverted(held @ self._inverse @ held.T)
        resting = [r for r in rows if r in self.counts.contact_rows]
        dq = 0 * self.q
        if resting:
            of_gaps = at.W[resting]
            miss = at.gaps[[r - self.counts.contact_rows.start for r in resting]]
            turned = _inverted(of_gaps @ self._inverse @ of_gaps.T) @ miss
            dq = -self._inverse @ of_gaps.T @ turned
        return dq, -back @ at.rates[rows]


def _inverted(matrix: Floats) -> Floats:
    """Return the inverse of a symmetric matrix, without the directions of dependent rows."""
    if np.iscomplexobj(matrix):  # for derivatives; then the rows are independent
        return np.asarray(np.linalg.inv(matrix))
    return np.asarray(np.linalg.pinv(matrix, rcond=DEPENDENT, hermitian=True))
