"""The modes of a run with contacts and dry friction, and quantities that depend on the mode."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from symsimpson.errors import reject
from symsimpson.program.program import Program
from symsimpson.results.interpolate import DenseOutput
from symsimpson.stepping.driving import inputs_at_times
from symsimpson.stepping.parts import PartialSteps
from symsimpson.support.array_types import Floats, Reals, State
from symsimpson.support.calling import explain_methods
from symsimpson.support.contact_values import Mode

if TYPE_CHECKING:
    from symsimpson.results.states import FinishedRun

#: Prefixes of normal forces and of friction in ``run[...]``.
NORMAL, FRICTION = "normal_", "friction_"
#: Columns of work after the forces: that of moving constraints, and the integral of dL/dt.
CONSTRAINTS, BY_TIME = "constraints", "dL/dt"


def work_names(program: Program) -> tuple[str, ...]:
    """Return the names of the columns of work of a system, or of a mode."""
    header, modes = program.header, program.modes
    forces = (*program.names.forces.shown, *(() if modes is None else modes.elements))
    carried = (CONSTRAINTS,) if header.carried or modes is not None else ()
    return (*forces, *carried, *(() if header.autonomous and modes is None else (BY_TIME,)))


@dataclass(frozen=True)
class Piece:
    """A piece of a run in one mode: its beginning, and the program that takes its steps."""

    t: float
    state: State
    step: int  #: The step in which it begins.
    mode: Mode
    program: Program = field(repr=False)
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
        return [piece.mode.states for piece in self.pieces]

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
        return dict(zip(self.names, self.pieces[place].mode.states, strict=True))

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

    def __len__(self) -> int:
        return len(self.pieces)

    def __repr__(self) -> str:
        return f"ModeHistory({', '.join(self.names)}: {len(self)} pieces)"


def _columns(run: Any) -> tuple[Floats, Floats, Floats]:
    """Return normal forces, friction and multipliers of constraints at the states of a run."""
    program, history = run.program, run.history
    modes = program.modes
    counts = modes.index_one.counts
    t, q, v = run.t, run.q, run.v
    inputs = inputs_at_times(program, run.driven, t)[0, :, 0]
    at = modes.index_one(
        t, q, v, run.parameter_values, np.broadcast_to(inputs, (len(t), inputs.shape[-1]))
    )
    places = history.places(t)
    normal, friction = np.zeros((len(t), counts.gaps)), np.zeros((len(t), counts.elements))
    held = np.zeros((len(t), len(counts.fixed_rows)))
    for place in np.unique(places):
        some = places == place
        mode = history.pieces[place].mode
        part = type(at)(*(x[some] for x in at))
        normal[some], friction[some], held[some] = mode_forces(part, counts, mode, modes.contact_of)
    return normal, friction, held


def mode_forces(at: Any, counts: Any, mode: Mode, contact_of: Any) -> tuple[Floats, Floats, Floats]:
    """Return normal forces, friction and multipliers of a mode at K states."""
    rows = list(counts.fixed_rows)
    fixed = len(rows)
    rows += [r for r, x in zip(counts.contact_rows, mode.contacts, strict=True) if x]
    resting = len(rows)
    rows += [r for r, x in zip(counts.element_rows, mode.elements, strict=True) if x == 0]
    K = len(at.push)
    W = at.W[:, rows]
    P, push = W.copy(), at.push.copy()
    P[:, :fixed] *= -1
    P[:, resting:] *= -1
    sliding = [
        (k, r, x)
        for k, (r, x) in enumerate(zip(counts.element_rows, mode.elements, strict=True))
        if x
    ]
    for k, r, sign in sliding:
        pull = sign * at.limits[:, k, None] * at.W[:, r]
        contact = contact_of[k]
        if contact is None:
            push -= pull
        else:
            P[:, rows.index(counts.contact_rows[contact])] -= pull
    normal, friction = np.zeros((K, counts.gaps)), np.zeros((K, counts.elements))
    m = len(rows)
    x = np.zeros((K, m))
    if m:
        G = W @ np.linalg.solve(at.M, P.swapaxes(1, 2))
        free = W @ np.linalg.solve(at.M, push[..., None])
        x = np.linalg.solve(G, -at.curve[:, rows, None] - free)[..., 0]
    for i, r in enumerate(rows):
        if r in counts.contact_rows:
            normal[:, r - counts.contact_rows.start] = x[:, i]
        elif r in counts.element_rows:
            friction[:, r - counts.element_rows.start] = x[:, i]
    for k, _, sign in sliding:
        contact = contact_of[k]
        load = 1.0 if contact is None else normal[:, contact]
        friction[:, k] = sign * at.limits[:, k] * load
    return normal, friction, x[:, :fixed]


def quantity_names(program: Program) -> list[str]:
    """Return the names of normal forces and friction."""
    modes = program.modes
    if modes is None:
        return []
    return [f"{NORMAL}{x}" for x in modes.contacts] + [f"{FRICTION}{x}" for x in modes.elements]


def forces_by_name(run: FinishedRun) -> dict[str, Floats]:
    """Return normal forces and friction at the states of a run, by name."""
    normal, friction, _ = _columns(run)
    return dict(zip(quantity_names(run.program), [*normal.T, *friction.T], strict=True))


def multipliers_of(run: FinishedRun) -> Floats:
    """Return the multipliers of the constraints of a run with contacts, shape (N + 1, m)."""
    return _columns(run)[2]


class DenseOutputOfModes(DenseOutput):
    """The dense output of a run with contacts or friction: each piece has its own mode."""

    def after(
        self, start: NDArray[np.int64], later: Reals
    ) -> tuple[Reals, Reals, NDArray[np.int64]]:
        """Return q, p and a status at the times ``later`` after the stored states ``start``."""
        run: Any = self._run
        t = np.asarray(run.t[start] + later, dtype=float)
        q, p = np.zeros((2, len(start), run.program.n))
        codes = np.zeros(len(start), dtype=np.int64)
        places = run.history.places(t)
        for i, place in enumerate(places.tolist()):
            if later[i] == 0:
                q[i], p[i] = run.q[start[i]], run.p[start[i]]
                continue
            (q[i], p[i]), codes[i] = self._in_piece(run.history.pieces[place], start[i], t[i])
        return q, p, codes

    def _in_piece(self, piece: Piece, start: int, t: float) -> tuple[Any, Any]:
        """Return the state at a time in a piece, from the last stored state or its beginning."""
        run, h, sign = self._run, float(self._run.h), self._sign
        first, every = float(run.t[0]), run.every or 1
        step, at, state = int(start) * every, float(run.t[start]), (run.q[start], run.p[start])
        for record in run.records:  # events of the user that do not change the mode
            if sign * at <= sign * record.t <= sign * t and sign * record.t >= sign * piece.t:
                step, at, state = record.step, record.t, (record.q_after, record.p_after)
        if sign * piece.t > sign * at:
            step, at, state = piece.step, piece.t, piece.state
        parts = PartialSteps(piece.program, piece.values, h, run.input_values)
        status: Any = 0
        while sign * (t - at) > 0 and status == 0:
            end = first + h * (step + 1)
            part = (end if sign * end < sign * t else t) - at
            state, status = parts(state, at, part, step, (at - first) / h - step)
            at, step = at + part, step + 1
        return state, status
