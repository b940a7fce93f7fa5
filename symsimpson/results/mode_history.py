"""The modes of a run with contacts and dry friction, and quantities that depend on the mode."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from symsimpson.errors import reject
from symsimpson.program.program import Program
from symsimpson.results.tables import Variable
from symsimpson.stepping.driving import inputs_at_times
from symsimpson.support.array_types import Floats, Reals, State
from symsimpson.support.calling import explain_methods
from symsimpson.support.contact_values import IndexOne, Mode, ModeEquations, weighted_mass

#: Prefixes of normal forces and of friction in ``run[...]``.
NORMAL, FRICTION = "normal_", "friction_"
#: The name of recorded work, and that of the sum over all forces.
WORK, TOTAL = "work", "total"
#: Columns of work after the forces: that of moving constraints, and the integral of dL/dt.
CONSTRAINTS, BY_TIME = "constraints", "dL/dt"


def work_names(program: Program, elements: Sequence[str] | None = None) -> tuple[str, ...]:
    """Return the names of the columns of work of a mode, or of a run with friction elements."""
    header, whole = program.header, elements is not None
    forces = (*program.names.forces.shown, *(elements or ()))
    carried = (_carried_name(program),) if header.carried or whole else ()
    return (*forces, *carried, *((BY_TIME,) if whole or not header.autonomous else ()))


def _carried_name(program: Program) -> str:
    """Return the name of the work of moving constraints.

    If only one friction element that sticks moves, it is the work of this element.
    """
    base, plain = getattr(program.declared, "base", None), getattr(program.declared, "plain", None)
    if base is None or plain is None or plain.moving or base.plain.carried:
        return CONSTRAINTS
    moved = [name for name, row in plain.velocity_constraints.items() if row[-1][0]]
    return moved[0] if len(moved) == 1 else CONSTRAINTS


def recorded_work(run: Any) -> tuple[dict[str, Reals], Reals]:
    """Return the recorded work of each force and element, and the integral of dL/dt."""
    history: ModeHistory = run.history
    if WORK not in run.recorded:
        reject(
            "the work is unknown, because contacts or friction acted on this run.",
            why="Steps that an event divides are not repeated.",
            remedy="Record it: record='work'.",
        )
    *names, _ = work_names(run.program, history.elements)
    rows = run.recorded[WORK]
    named = {name: rows[:, k] for k, name in enumerate(names)}
    if not named[CONSTRAINTS].any():
        del named[CONSTRAINTS]
    return named | {TOTAL: rows[:, : len(names)].sum(axis=1)}, rows[:, len(names)]


def powers(run: Any, of_forces: Reals) -> dict[str, Reals]:
    """Return the power of each force and friction element at the states of a run.

    ``of_forces`` has the powers of the forces of the system, a column for each.
    """
    names = run.program.names.forces.shown
    named = {name: of_forces[:, k] for k, name in enumerate(names)}
    friction, speeds = forces_by_name(run), _speeds(run)
    for name, speed in zip(run.history.elements, speeds.T, strict=True):
        named[name] = -friction[f"{FRICTION}{name}"] * speed
    return named | {TOTAL: sum(named.values(), 0 * run.t)}


@dataclass(frozen=True)
class Piece:
    """A piece of a run in one mode: its beginning, and the program that takes its steps."""

    t: float
    state: State
    step: int  #: The step in which it begins.
    mode: Mode
    states: tuple[str | int | None, ...]  #: The mode as users see it.
    program: Program | None = field(repr=False)  #: None in a run from a file.
    values: Reals = field(repr=False)  #: Parameters, with the directions of sliding.
    causes: Any = field(repr=False)  #: What the events of the piece stand for.


@explain_methods()
@dataclass(frozen=True, eq=False, repr=False)
class ModeHistory:
    """The modes of a run, in the order of time; ``run.modes`` returns it.

    Attributes
    ----------
    names : tuple of str
        Names of the contacts and friction elements. The friction of a contact "floor" is
        "floor.slip".
    choices : int
        How often several modes were possible that needed equally few changes. The run took the
        first of them.

    Examples
    --------
    >>> import symsimpson as ss
    >>> (x,) = ss.coordinates("x")
    >>> brake = ss.MechanicalSystem("brake", coordinates=(x,), kinetic=x.diff()**2/2,
    ...                             potential=0*x, friction={"pad": ss.Friction(x.diff(), limit=2)})
    >>> run = ss.compile(brake).integrate([0.0], v0=[1.0], h=0.1, t_end=1.0)
    >>> run.modes.t.round(12).tolist(), run.modes.states, run.modes.at(0.2)
    ([0.0, 0.5], [(1,), (0,)], {'pad': 1})
    """

    names: tuple[str, ...]
    pieces: tuple[Piece, ...]
    choices: int
    contacts: int  #: Number of contacts, which are the first names.
    works: bool  #: Whether friction or moving contacts do work.

    @property
    def elements(self) -> tuple[str, ...]:
        """Names of the friction elements."""
        return self.names[self.contacts :]

    @property
    def t(self) -> Floats:
        """Times at which a mode begins, the initial time first."""
        return np.array([piece.t for piece in self.pieces])

    @property
    def states(self) -> list[tuple[str | int | None, ...]]:
        """The state of each name in each mode.

        Contacts are "open" or "rest". Friction sticks (0), slides in the direction of its sign
        (1, -1), or belongs to an open contact (None).
        """
        return [piece.states for piece in self.pieces]

    def at(self, t: float) -> dict[str, str | int | None]:
        """Return the state of each name at a time.

        Parameters
        ----------
        t : float
            Time within the run. At a change, the mode that begins counts.

        Returns
        -------
        dict

        Raises
        ------
        InputError
            If the time lies before the run.
        """
        place = int(self.places(np.array([float(t)]))[0])
        return dict(zip(self.names, self.pieces[place].states, strict=True))

    def places(self, t: Reals) -> NDArray[np.int64]:
        """Return the number of the piece at each time."""
        begun = self.t
        sign = -1.0 if len(begun) > 1 and begun[-1] < begun[0] else 1.0
        places = np.searchsorted(sign * begun, sign * np.asarray(t, dtype=float), "right") - 1
        if (places < 0).any() and sign * float(np.min(sign * t)) < sign * begun[0]:
            reject(
                f"the time {float(np.min(t)):g} lies before the run.",
                remedy=f"The run begins at t={begun[0]:g}.",
            )
        return np.maximum(places, 0)

    def since(self, step: int) -> ModeHistory:
        """Return the modes with their steps counted from another step of the run."""
        pieces = (replace(piece, step=piece.step - step) for piece in self.pieces)
        return replace(self, pieces=tuple(pieces))

    def as_json(self) -> dict[str, Any]:
        """Return the modes as JSON values, without their programs."""
        pieces = [
            [x.t, *(y.tolist() for y in x.state), x.step, *x.mode, x.states] for x in self.pieces
        ]
        about = {"names": self.names, "contacts": self.contacts, "works": self.works}
        return about | {"choices": self.choices, "pieces": pieces}

    @classmethod
    def read(cls, given: Mapping[str, Any]) -> ModeHistory:
        """Return the modes from the values that ``as_json`` returns."""
        pieces = []
        for t, q, p, step, contacts, elements, states in given["pieces"]:
            mode, state = Mode(tuple(contacts), tuple(elements)), (np.array(q), np.array(p))
            pieces.append(Piece(t, state, step, mode, tuple(states), None, np.zeros(0), ()))
        about = given["choices"], given["contacts"], given["works"]
        return cls(tuple(given["names"]), tuple(pieces), *about)

    def __len__(self) -> int:
        return len(self.pieces)

    def __repr__(self) -> str:
        return f"ModeHistory({', '.join(self.names)}: {len(self)} pieces)"


def check_whole(run: Any) -> None:
    """Raise InputError for a run whose modes are not known, as from a file or an ensemble."""
    if run.history is None or not is_whole(run.history):
        reject(
            "the equations of contacts and friction are not known here.",
            where=run.program.system,
            why="The run is from a file, or it is a member of an ensemble.",
            remedy="Repeat the run: stepper.integrate(...).",
        )


def is_whole(history: ModeHistory) -> bool:
    """Return whether the programs of all modes are known."""
    return all(piece.program is not None for piece in history.pieces)


def _at_states(run: Any) -> Any:
    """Evaluate accelerations, gaps and velocities of sliding at the states of a run."""
    check_whole(run)
    inputs = inputs_at_times(run.program, run.driven, run.t)[0, :, 0]
    inputs = np.broadcast_to(inputs, (len(run.t), inputs.shape[-1]))
    return run.program.modes.index_one(run.t, run.q, run.v, run.parameter_values, inputs)


def _speeds(run: Any) -> Floats:
    """Return A v of each friction element at the states of a run."""
    at, rows = _at_states(run), run.program.modes.index_one.counts.element_rows
    speeds: Floats = np.einsum("kij,kj->ki", at.W[:, rows.start : rows.stop], run.v)
    return speeds


def _columns(run: Any) -> tuple[Floats, Floats, Floats]:
    """Return normal forces, friction and multipliers of constraints at the states of a run."""
    at, modes, places = _at_states(run), run.program.modes, run.history.places(run.t)
    counts = modes.index_one.counts
    sizes = counts.gaps, counts.elements, len(counts.fixed_rows)
    columns = [np.zeros((len(run.t), size)) for size in sizes]
    for place in np.unique(places):
        some = places == place
        part = IndexOne(*(x[some] for x in at))
        about = part, counts, run.history.pieces[place].mode, modes.contact_of
        equations = ModeEquations.of(*about)
        rows, W, P, push, _ = equations
        M, weight = weighted_mass(part, counts)
        right = -part.curve[:, rows, None] - W @ np.linalg.solve(M, push[..., None])
        x: Any = np.linalg.solve(W @ np.linalg.solve(M, P.swapaxes(1, 2)), right)[..., 0]
        m = counts.constraints
        x[:, :m] -= weight[:, None] * part.curve[:, :m]
        parts = *equations.forces(x, *about), x[:, : sizes[2]]
        for column, values in zip(columns, parts, strict=True):
            column[some] = values
    normal, friction, multipliers = columns
    return normal, friction, multipliers


def quantity_names(program: Program, history: ModeHistory | None = None) -> list[str]:
    """Return the names of normal forces and friction."""
    named, modes = program.modes if history is None else history, program.modes
    if named is None:
        return []
    contacts = modes.contacts if history is None else history.names[: history.contacts]
    return [f"{NORMAL}{x}" for x in contacts] + [f"{FRICTION}{x}" for x in named.elements]


def forces_by_name(run: Any) -> dict[str, Floats]:
    """Return normal forces and friction at the states of a run, by name."""
    normal, friction, _ = _columns(run)
    return dict(
        zip(quantity_names(run.program, run.history), [*normal.T, *friction.T], strict=True)
    )


def force_variables(run: Any) -> list[Variable]:
    """Return normal forces and friction as variables, if they can be computed."""
    if run.history is None or not is_whole(run.history):
        return []
    forces = forces_by_name(run).items()
    return [
        Variable(f"contact_force_{k}", values, ("time",), name, (name,))
        for k, (name, values) in enumerate(forces)
    ]


def constraint_values(run: Any) -> tuple[Floats, Floats]:
    """Return the multipliers of the constraints at states, and the forces of all of them."""
    multipliers, at = _columns(run)[2], _at_states(run)
    rows = run.program.modes.index_one.counts.fixed_rows
    return multipliers, -np.einsum("kij,ki->kj", at.W[:, rows], multipliers)
