"""Kernels of large systems: loops over nodes, coordinates and unknowns."""

from __future__ import annotations

from dataclasses import dataclass

from symsimpson.codegen.constraint_order import Held
from symsimpson.codegen.ir import Call, IfActive, Kernel, Loop, Statement
from symsimpson.codegen.storage import Storage
from symsimpson.codegen.unrolled import acceptance, convergence, lanes
from symsimpson.discrete.reductions import Constrained, Coupled, Separable
from symsimpson.module.interface import PIVOTED

__all__ = ["LoopKernels"]

_NODE = ("W", "h", "node", "lane")
_POINT = ("W", "h", "point", "lane")
_AT_NODE = "t + PLACES[node] * h"


def _call(name: str, *arguments: str) -> Call:
    return Call(name, arguments) if arguments else Call(name)


@dataclass(frozen=True)
class LoopKernels:
    """Makes kernels of loops over nodes, coordinates and unknowns."""

    storage: Storage
    degree: int
    autonomous: bool  #: Whether nothing depends on t.
    dragged: bool  #: Whether forces depend on v.
    driven: bool  #: Whether there are inputs.
    damped: bool  #: Whether the weights of nodes grow.
    held: Held | None  #: How constraints stand among the coordinates, if there are any.
    #: Whether M is, so that its factors may stay in their place from step to step.
    constant_mass: bool
    #: Whether Newton's method needs no exchange of rows, but for a few steps.
    in_order: bool = False
    carried: bool = False  #: Whether velocity constraints do work.
    written: Call | None = None  #: What assembles the equations, where they are written out.

    @property
    def rolling(self) -> bool:
        """Whether some constraints are those of velocities."""
        return self.held is not None and self.held.velocities > 0

    @property
    def cleared(self) -> int:
        """Rows of the matrix of all unknowns that sums or elimination begin with as zero."""
        storage = self.held.storage if self.held else self.storage
        return storage.size(self.degree) if self.held or storage.banded else 0

    @property
    def alike(self) -> bool:
        """Whether a force is the same at the end of a step and at the start of the next one."""
        return self.autonomous and not self.driven

    def _time(self, time: str, node: str) -> tuple[Statement, ...]:
        """Keep the time of a node and the inputs there, if something depends on them."""
        timed = () if self.autonomous else (_call("node_time", "W", time, "lane"),)
        return (*timed, *((_call("node_inputs", "W", node, "lane"),) if self.driven else ()))

    def start(self, time: str = "t") -> tuple[Statement, ...]:
        """Go to the start of the path."""
        return (_call("path_start"), *self._time(time, "0"))

    def nodes(self, over: str, *body: Statement) -> Loop:
        """Go over nodes of the path."""
        return Loop("node", over, (_call("path", *_NODE), *self.time_at_node(), *body))

    def time_at_node(self) -> tuple[Statement, ...]:
        """Keep the time at a node of the step and the inputs there, if something needs them."""
        return self._time(_AT_NODE, "node")

    def _velocity(self, time: str = "t") -> tuple[Statement, ...]:
        """Factorise M at the state."""
        return (*self.start(time), _call("mass"), *self.factors())

    def mass_again(self) -> tuple[Statement, ...]:
        """Factorise a constant M again, where something else took its place."""
        return self._velocity("t + h") if self.constant_mass else ()

    def factors(self) -> tuple[Statement, ...]:
        """Factorise M, bordered by constraints if there are any."""
        if not self.held:
            return (_call("factor_mass"),)
        names = ("constraint_slopes", "border_mass", "factor_held")
        return tuple(map(_call, names))

    def solve_momentum(self) -> tuple[Statement, ...]:
        """Solve for the velocity, with these factors."""
        asked = "hold_velocities" if self.rolling else "allow_no_change"
        names = (asked, "solve_held") if self.held else ("solve_mass",)
        return tuple(map(_call, ("momentum_to_solve", *names)))

    def equations(self) -> Kernel:
        """Return the equations themselves, all of them, whatever a step solves."""
        doc = "Residual and Jacobian of the step, rows in the order of elimination."
        return Kernel("equations", doc, lanes(self.all_rows()))

    def all_rows(self) -> tuple[Statement, ...]:
        """Assemble the equations: residual and Jacobian."""
        if self.written is not None:
            return (self.written,)
        return (
            _call("clear_residual"),
            *self.matrix(_call("assemble_rows", *_NODE)),
            *self.points(self.every_point, "constrain", _call("assemble_constraint", *_POINT)),
            *self.rates(_call("assemble_rates", *_NODE)),
        )

    def matrix(self, *at_nodes: Statement) -> tuple[Statement, ...]:
        """Assemble what nodes contribute to the Jacobian; more is done at each, with its jet."""
        grown = (_call("grow_node", "W", "node", "lane"),) if self.damped else ()
        drag = (_call("keep_drag", "W", "node", "lane"),) if self.dragged else ()
        kept = _call("keep_jet", "W", "node", "lane")
        return (
            self.nodes("range(NODES)", _call("jet"), *grown, *at_nodes, kept, *drag),
            *((_call("clear_matrix", "W", "lane", str(self.cleared)),) if self.cleared else ()),
            _call("assemble_matrix", "W", "h", "lane"),
            *((_call("assemble_matrix_of_drag"),) if self.dragged else ()),
        )

    @property
    def every_point(self) -> str:
        """The control points at which constraints pull, or phi = 0: there is no pull at the end."""
        of_positions = self.held is not None and self.held.count > self.held.velocities
        return "range(DEGREE + 1)" if of_positions else "range(DEGREE)"

    def points(self, over: str, function: str, *body: Statement) -> tuple[Statement, ...]:
        """Go over control points, if there are constraints at them."""
        if not self.held:
            return ()
        here = [_call("control_point", "W", "point", "lane")]
        if self.rolling and not self.autonomous:
            here.append(_call("node_time", "W", "t + POINTS[point] * h", "lane"))
        return (Loop("point", over, (*here, _call(function), *body)),)

    def rates(self, *body: Statement) -> tuple[Statement, ...]:
        """Go over the points at which A v = b is asked for, behind the nodes of the path."""
        if not self.rolling:
            return ()
        timed = () if self.autonomous else (_call("node_time", "W", _AT_NODE, "lane"),)
        here = (_call("path", *_NODE), *timed, _call("rates"))
        return (Loop("node", "range(NODES, NODES + DEGREE)", (*here, *body)),)

    def pivoted(self, *, following: bool) -> Kernel:
        """Return Newton's iteration for all equations, where the fixed order of elimination fails.

        Coordinates whose increments are ``following`` from those of the others are solved for
        first: what is left is the iteration of the reduced equations.
        """
        rows = self.all_rows()
        first = (*rows, _call("solve_following"), *rows) if following else rows
        leave = (_call("clear_following"),) if following else ()
        body = (*first, *self._corrected(*leave))
        doc = "One Newton iteration with row pivoting, where the fixed order of elimination fails."
        return Kernel(PIVOTED, doc, lanes((IfActive(body),)))

    def _corrected(self, *leave: Statement, in_order: bool = False) -> tuple[Statement, ...]:
        """Solve for a correction, leave out of it what follows, and apply it."""
        solve = (_call("solve_pivoted"), *leave, _call("update_increments"))
        if self.held:
            matrix = ("JACOBIAN + SOLVE_OFFSET", "SOLVE_UNKNOWNS", "SOLVE_STRIDE", "lane")
            find: tuple[Statement, ...] = (_call("solve_pivoted"),)
            if in_order:
                right = (matrix[0], "RESIDUAL", *matrix[1:])
                find = (
                    _call("factor_in_order", "W", *matrix),
                    _call("solve_in_order", "W", *right),
                )
            parted = _call("part_rows", "W", "RESIDUAL", "lane")
            applied = map(_call, ("update_increments", "update_multipliers"))
            solve = (_call("join_equations"), *find, parted, *applied)
        return (*solve, *convergence(bool(self.held)))

    def step(self, part: Constrained | Coupled | Separable) -> list[Kernel]:
        """Return the kernels of a step."""
        constant = isinstance(part, Separable)
        again = self.solve_momentum()
        first = (_call("keep_mass"),) if constant else ()
        begin = (
            *self.start(),
            _call("mass"),
            *first,
            *self.factors(),
            *self._pivots("scale_pivots"),
            *again,
            _call("straight_path", "W", "h", "lane"),
            *((_call("clear_multipliers"),) if self.held else ()),
        )
        rows: tuple[Statement, ...]
        if constant:
            size = str(self.storage.size(len(part.columns)))
            rows = (
                _call("clear_matrix", "W", "lane", size),
                _call("inertia", "W", "h", "lane"),
                self.nodes("FORCE_NODES", _call("forces"), _call("assemble_forces", *_NODE)),
            )
        else:
            rows = self.all_rows()
        if isinstance(part, Separable) and part.last is not None:
            rows = (*self._end_of_path(), *rows)
        newton: tuple[Statement, ...] = (*rows, *self._corrected(in_order=self.in_order))
        kept = (_call("keep_taken"),) if self.carried else ()
        held = (*kept, _call("project_momentum"), _call("carry_multipliers")) if self.held else ()
        following: tuple[Statement, ...] = (
            *again,
            *held,
            _call("predict", "W", "h", "lane"),
            *acceptance(bool(self.held), not self.constant_mass),
        )
        closing: tuple[Statement, ...] = ()
        if isinstance(part, Separable) and part.last is not None:
            closing = self._end_of_path()
        advance = (
            *closing,
            _call("clear_momentum"),
            self.nodes("range(NODES)", _call("gradient"), _call("accumulate", *_NODE)),
            *self.points("range(DEGREE)", "constraint_slopes", _call("add_pull", "W", "h", "lane")),
            _call("close_step"),
            *(() if constant else (*self._velocity("t + h"), *self._pivots("compare_pivots"))),
            *(following if part.columns else ()),
        )
        step = lanes((IfActive(advance),))
        beginning = [
            Kernel("start", "Begin at (q, p) with increments of constant velocity.", lanes(begin)),
            Kernel(
                "legendre",
                "p = dL/dv from q and v.",
                lanes((*self.start(), _call("mass"), _call("momentum"))),
            ),
        ]
        if not part.columns:  # nothing to solve, nothing to predict
            step = (Loop("step", "range(int(W[COUNT, 0]))", step),)
            doc = "Take as many steps as W[COUNT] says, by compensated sums."
            return [*beginning, Kernel("advance", doc, step)]
        return [
            *beginning,
            Kernel(
                "newton",
                "One Newton iteration, assembled node by node, with row pivoting."
                if not self.in_order
                else "One Newton iteration, assembled node by node.",
                lanes((IfActive(newton),)),
            ),
            Kernel(
                "advance",
                "Close a step by compensated sums, then predict the next increments.",
                step,
            ),
        ]

    def _end_of_path(self) -> tuple[Statement, ...]:
        """Find X_d where it is no unknown."""
        return (
            _call("clear_momentum"),
            self.nodes("LAST_NODES", _call("gradient"), _call("accumulate_last", *_NODE)),
            _call("end_path", "W", "h", "lane"),
        )

    def composed(self) -> list[Kernel]:
        """Return the kernels of an explicit step with loops over kicks and drifts."""
        momentum = (*self.start(), _call("mass"))
        begin = (
            *momentum,
            *self.factors(),
            *self.solve_momentum(),
            *self.start(),
            _call("gradient"),
        )
        drift, held = ("drift_held", self.factors()) if self.held else ("drift", ())
        parts = Loop(
            "part",
            "range(len(DRIFTS))",
            (
                _call(drift, "W", "h", "part", "lane"),
                *self._time("t + REACHED[part] * h", "part + 1"),
                *held,
                _call("gradient"),
                _call("kick", "W", "h", "part + 1", "lane"),
            ),
        )
        # the force at the end of a step is that at the start of the next one, unless t is rounded
        # or inputs are others there
        again = () if self.alike else (*self.start(), _call("gradient"))
        end = (_call("free_velocity"), _call("take_momentum")) if self.held else ()
        kick = _call("first_kick", "W", "h", "lane")
        closing = (*again, kick, parts, *end, _call("close_composed"))
        step = lanes((IfActive(closing),))
        return [
            Kernel("start", "Begin at (q, p) with the force there.", lanes(begin)),
            Kernel("legendre", "p = dL/dv from q and v.", lanes((*momentum, _call("momentum")))),
            Kernel(
                "advance",
                "Take as many steps as W[COUNT] says: kicks, and drifts between them.",
                (Loop("step", "range(int(W[COUNT, 0]))", step),),
            ),
        ]

    def energy(self) -> Kernel:
        """Return H = v.(p - a)/2 + V, and the first of the two alone."""
        body = (*self.before_state(), _call("kinetic_energy"), *self.start(), _call("potential"))
        doc = "The Hamiltonian at (q, p), its kinetic part, and the velocities."
        return Kernel("energy", doc, lanes(body))

    def work(self, *, following: bool) -> Kernel:
        """Return the integrals of powers over the step that was taken.

        Increments of coordinates that are ``following`` from the others are solved for first.
        """
        exchange = _call("exchange_steps")
        first = (*self.all_rows(), _call("solve_following")) if following else ()
        nodes = self.nodes("range(NODES)", _call("node_power"), _call("add_work", *_NODE))
        pulled: tuple[Statement, ...] = ()
        ended: tuple[Statement, ...] = ()
        if self.carried:
            added = _call("add_carried", "W", "h", "lane")
            pulled = self.points("range(DEGREE)", "hold_velocities", added)
            ended = (*self.start("t + h"), _call("hold_velocities"), _call("add_carried_end"))
        step = (exchange, *first, nodes, *pulled, exchange, *ended, _call("sum_work"))
        doc = "Add the work of forces in the step that was taken, and the integral of dL/dt."
        return Kernel("work", doc, lanes((IfActive(step),)))

    def _pivots(self, name: str) -> tuple[Statement, ...]:
        """Keep the pivots of M where a run begins, or compare others with them, if M changes."""
        first = "HELD" if self.held else "NODE_L_VV"
        return () if self.constant_mass else (_call(name, "W", first, "lane"),)

    @property
    def pivots(self) -> dict[str, object]:
        """Where each pivot of M stands among the factors."""
        storage = self.held.storage if self.held else self.storage
        places = self.held.place[: self.storage.n] if self.held else range(self.storage.n)
        step, offset = storage.node_stride + 1, storage.node_offset
        return {} if self.constant_mass else {"PIVOT_AT": tuple(i * step + offset for i in places)}

    def before_state(self) -> tuple[Statement, ...]:
        """Return what finds the velocities of a state."""
        return (*self._velocity(), *self.solve_momentum())

    def before_pushes(self) -> tuple[Statement, ...]:
        """Return what finds phi and the velocities of a state."""
        # all at one place: its slopes and factors serve three solves
        nearest = (*self._velocity(), *map(_call, ("constrain", "change_to_constraints")))
        return (*nearest, *self.solve_momentum())

    def pushed(self) -> tuple[Statement, ...]:
        """Return what finds multipliers then; accelerations take the places of velocities."""
        return tuple(map(_call, ("pushes", "push_to_solve", "solve_held", "constraint_forces")))

    def multipliers(self) -> Kernel:
        """Return the kernel of phi and of multipliers that keep accelerations allowed."""
        doc = "phi and the multipliers of L - lambda.phi at (q, p)."
        return Kernel("multipliers", doc, lanes((*self.before_pushes(), *self.pushed())))
