"""Modes of contacts and friction, and the equations of accelerations at a state, as numbers."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from symsimpson.errors import InputError, SymsimpsonError, reject
from symsimpson.support.array_types import Floats

#: The contact of each friction element, or None.
Contacts = Sequence[int | None]
#: Values of a contact in a mode, as users see them.
OPEN, REST = "open", "rest"
#: Follows the name of a contact, or of a joint of a robot, in the name of its friction.
OF_CONTACT = ".slip"


class Mode(NamedTuple):
    """Which contacts rest, and what each friction element does.

    An element sticks (0), slides in the direction of its sign (1 or -1), or carries no force
    (None). The last one belongs to an open contact, or sticks because others stick.
    """

    contacts: tuple[bool, ...]
    elements: tuple[int | None, ...]

    @property
    def key(self) -> Mode:
        """The mode without directions. Modes with equal keys have the same module."""
        return Mode(self.contacts, tuple(x and 1 for x in self.elements))

    def states(self, contact_of: Sequence[int | None]) -> tuple[str | int | None, ...]:
        """Return the state of each contact and element, as users see it."""
        pairs = zip(self.elements, contact_of, strict=True)
        shown = (
            0 if state is None and (c is None or self.contacts[c]) else state for state, c in pairs
        )
        return (*(REST if rests else OPEN for rests in self.contacts), *shown)

    def with_contact(self, contact: int, rests: bool) -> Mode:
        """Return the mode in which one contact rests, or is open."""
        return self._replace(contacts=_with(self.contacts, contact, rests))

    def with_element(self, element: int, state: int) -> Mode:
        """Return the mode in which one friction element has another state."""
        return self._replace(elements=_with(self.elements, element, state))

    def changes(self, other: Mode) -> int:
        """Return the number of contacts and elements that differ; None does not count."""
        pairs = [*zip(self.contacts, other.contacts, strict=True)]
        moved = zip(self.elements, other.elements, strict=True)
        return sum(a != b for a, b in pairs) + sum(
            a != b for a, b in moved if a is not None and b is not None
        )


def _with(values: tuple[Any, ...], place: int, value: Any) -> tuple[Any, ...]:
    """Return values with one of them replaced."""
    return (*values[:place], value, *values[place + 1 :])


class IndexOne(NamedTuple):
    """M v' = push + (forces of rows) and W v' = -curve at states, with leading axes of states.

    Rows of W are constraints of positions, gaps, velocity constraints, then friction elements.
    ``rates`` are W v - b of each row, ``gaps`` the values of the gaps.
    """

    M: Floats
    W: Floats
    push: Floats
    curve: Floats
    rates: Floats
    gaps: Floats
    limits: Floats  #: Limit or coefficient of each element at its speed, then its static one.
    momenta: Floats  #: The part of the momenta that does not depend on velocities.


def weighted_mass(at: IndexOne, counts: Counts) -> tuple[Floats, Floats]:
    """Return M + w Phi^T Phi, which is regular, and w, for constraints of positions.

    M itself is singular for a quaternion. The sum gives the same accelerations. It adds w times
    ``curve`` to the multipliers of the constraints.
    """
    slopes = at.W[..., : counts.constraints, :]
    if not counts.constraints:
        return at.M, np.zeros(at.push.shape[:-1])
    square = np.swapaxes(slopes, -1, -2) @ slopes
    traces = (np.trace(x, axis1=-2, axis2=-1) for x in (at.M, square))
    mass, size = traces
    weight = mass / size
    return at.M + weight[..., None, None] * square, weight


class Counts(NamedTuple):
    """Numbers of constraints of positions, gaps, velocity constraints and friction elements."""

    constraints: int
    gaps: int
    rolling: int
    elements: int

    @property
    def contact_rows(self) -> range:
        """Rows of the gaps."""
        return range(self.constraints, self.constraints + self.gaps)

    @property
    def element_rows(self) -> range:
        """Rows of the friction elements."""
        first = self.constraints + self.gaps + self.rolling
        return range(first, first + self.elements)

    @property
    def fixed_rows(self) -> list[int]:
        """Rows of the constraints, which hold in every mode."""
        first = self.constraints + self.gaps
        return [*range(self.constraints), *range(first, first + self.rolling)]


class ModeEquations(NamedTuple):
    """W M^-1 P x = -curve - W M^-1 push for the multipliers x of a mode, with leading axes.

    P has a column for each row that holds: W with the opposite sign, and n - mu A for the gap of a
    contact that slides, with A in the direction of sliding.
    """

    rows: list[int]
    W: Floats
    P: Floats
    push: Floats
    sizes: Floats  #: Bounds of the terms of ``push``.

    @classmethod
    def of(cls, at: IndexOne, counts: Counts, mode: Mode, contact_of: Contacts) -> ModeEquations:
        """Return the equations of a mode."""
        rows = rows_of_mode(counts, mode)
        W, push, sizes = at.W[..., rows, :], at.push.copy(), np.abs(at.push)
        P = -W
        for i, r in enumerate(rows):
            if r in counts.contact_rows:
                P[..., i, :] *= -1
        for k, (r, state) in enumerate(zip(counts.element_rows, mode.elements, strict=True)):
            if not state:
                continue
            pull, contact = state * at.limits[..., k, None] * at.W[..., r, :], contact_of[k]
            if contact is None:
                push, sizes = push - pull, sizes + np.abs(pull)
            else:
                P[..., rows.index(counts.contact_rows[contact]), :] -= pull
        return cls(rows, W, P, push, sizes)

    def forces(
        self, x: Floats, at: IndexOne, counts: Counts, mode: Mode, contact_of: Contacts
    ) -> tuple[Floats, Floats]:
        """Return normal forces of contacts and multipliers of friction from multipliers x."""
        normal = np.zeros((*x.shape[:-1], counts.gaps))
        friction = np.zeros((*x.shape[:-1], counts.elements))
        for i, r in enumerate(self.rows):
            if r in counts.contact_rows:
                normal[..., r - counts.contact_rows.start] = x[..., i]
            elif r in counts.element_rows:
                friction[..., r - counts.element_rows.start] = x[..., i]
        for k, state in enumerate(mode.elements):
            if state:
                contact = contact_of[k]
                load = 1.0 if contact is None else normal[..., contact]
                friction[..., k] = state * at.limits[..., k] * load
        return normal, friction


def rows_of_mode(counts: Counts, mode: Mode) -> list[int]:
    """Return the rows that hold in a mode: constraints, gaps at rest, elements that stick."""
    resting = zip(counts.contact_rows, mode.contacts, strict=True)
    sticking = zip(counts.element_rows, mode.elements, strict=True)
    rows = [*counts.fixed_rows, *(r for r, rests in resting if rests)]
    return rows + [r for r, state in sticking if state == 0]


def reject_contacts(
    modes: Any, name: str, what: str, error: type[SymsimpsonError] = InputError
) -> None:
    """Raise an error if a system has modes of contacts or dry friction, which exclude ``what``."""
    if modes is not None:
        reject(
            f"{what} cannot be combined with contacts or dry friction.",
            where=f"system {name!r}",
            remedy="Use the system of one mode: system.mode({'floor': 'rest'}).",
            error=error,
        )
