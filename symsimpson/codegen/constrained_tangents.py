"""Constraints in kernels that differentiate a step: at control points, and at its end."""

from __future__ import annotations

from symsimpson.codegen.differentials import GO_TO_NODE, Differentials
from symsimpson.codegen.ir import Call, Index, Loop, Statement

__all__ = ["HeldDifferentials"]

_AT_POINT = ("W", "h", "point", "dq", "room", "lane")
_AT_NODE = ("W", "h", "node", "lane")
_BY_PARAMETER = ("W", "room", "parameter", "lane")


class HeldDifferentials(Differentials):
    """Makes these parts; without constraints each of them is empty."""

    def if_held(self, *statements: Statement) -> tuple[Statement, ...]:
        """Return statements where there are constraints."""
        return statements if self.loops.held else ()

    def assembled(self, *more: Statement) -> tuple[Statement, ...]:
        """Assemble the matrix of the step's derivatives; ``more`` is done at each node."""
        here = (Call("go_to_point", ("W", "h", "point", "lane")),)
        points = (
            *(here if self.low.sized and self.loops.rolling else ()),
            *self.if_varied(Call("constraint_parameter_slopes"), _kept("keep_point_slopes")),
        )
        rate_slopes = self.if_varied(
            *self.at(GO_TO_NODE), Call("rate_parameter_slopes"), Call("keep_rate_slopes", _AT_NODE)
        )
        constraint = Call("assemble_constraint", ("W", "h", "point", "lane"))
        return (
            *self.loops.matrix(*self.parameter_slopes(), *more),
            Call("assemble_slopes", ("W", "h", "lane")),
            *((Call("assemble_slopes_of_drag"),) if self.loops.dragged else ()),
            *self.loops.points(
                self.loops.every_point, "constrain", constraint, _kept("keep_point"), *points
            ),
            *self.loops.rates(
                Call("assemble_rates", _AT_NODE), Call("keep_rates", _AT_NODE), *rate_slopes
            ),
        )

    def varied_points(self) -> tuple[Statement, ...]:
        """Add what constraints at control points contribute to the right sides."""
        varied = self.if_varied(
            Call("add_constraint_slopes", ("W", "h", "point", "room", "parameter", "lane"))
        )
        return self._points("range(DEGREE + 1)", each(Call("vary_constraint", _AT_POINT), *varied))

    def _points(self, over: str, *body: Statement) -> tuple[Statement, ...]:
        """Go over control points whose matrices are kept, if there are constraints."""
        return self.if_held(Loop("point", over, body))

    def joined(self) -> tuple[Statement, ...]:
        """Bring equations and right sides into the order of elimination."""
        return self.if_held(Call("join_equations"), each(self._of_room("join_rows")))

    def parted(self) -> tuple[Statement, ...]:
        """Bring solutions back into the order of increments and multipliers."""
        return self.if_held(each(self._of_room("part_rows")))

    def pulls(self) -> tuple[Statement, ...]:
        """Add what the pulls of constraints change by to dp1 - dp0."""
        return self._points("range(DEGREE)", each(Call("vary_pull", _AT_POINT)))

    def impulse(self) -> tuple[Statement, ...]:
        """Find p1 - p0 once more, before the projection."""
        if not self.loops.held:
            return ()
        nodes = self.loops.nodes(
            "range(NODES)", Call("jet"), Call("accumulate", ("W", "h", "node", "lane"))
        )
        pulls = self.loops.points(
            "range(DEGREE)", "constraint_slopes", Call("add_pull", ("W", "h", "lane"))
        )
        return (Call("clear_momentum"), nodes, *pulls)

    def projected(self) -> tuple[Statement, ...]:
        """Project the variations of p at the end of the step; velocities are found once more."""
        if not self.loops.held:
            return ()
        curvature = Loop(
            "constraint",
            "range(CONSTRAINTS)",
            (
                Call("choose_constraint", ("W", "constraint", "lane")),
                Call("constrain"),
                *self._slopes(),
                each(
                    Call("vary_curvature", ("W", "constraint", "dq", "room", "lane")),
                    *self.if_varied(
                        Call("add_curvature_slopes", ("W", "constraint", *_BY_PARAMETER[1:]))
                    ),
                ),
            ),
        )
        carried = self._carried(
            each(
                Call("vary_carried", ("W", "dq", "room", "lane")),
                *self.if_varied(Call("add_carried_slopes", _BY_PARAMETER)),
            )
        )
        taken = map(Call, ("momentum_taken", "allow_no_change", "solve_held", "constrain"))
        begun = each(
            Call("begin_projection", ("W", "dq", "room", "lane")),
            *self.if_varied(Call("add_projection_slopes", _BY_PARAMETER)),
        )
        closed = each(
            Call("take_right_side", ("W", "room", "lane")),
            Call("solve_held"),
            Call("close_projection", ("W", "dq", "lane")),
            *self.if_varied(Call("add_momentum_slopes", ("W", "dq", "parameter", "lane"))),
        )
        return (
            *self.loops.start("t + h"),
            Call("mass"),
            *self.loops.factors(),
            *self.loops.solve_momentum(),
            Call("jet"),
            *self.at_state(1),
            curvature,
            *carried,
            *taken,
            *self._slopes(),
            begun,
            closed,
            *self.loops.solve_momentum(),
        )

    def _carried(self, *body: Statement) -> tuple[Statement, ...]:
        """Find the derivatives of b of velocity constraints, if there is any, before statements."""
        if not self.loops.carried:
            return ()
        return (Call("carried_slopes"), *self.if_varied(Call("carried_parameter_slopes")), *body)

    def _slopes(self) -> tuple[Statement, ...]:
        return self.if_varied(Call("constraint_parameter_slopes"))

    def pulled_end(self) -> tuple[Statement, ...]:
        """Go to the end of the step, and undo its projection for derivatives of a cost."""
        if not self.loops.held:
            return ()
        return (
            Call("exchange_steps"),
            *self.impulse(),
            Call("exchange_steps"),
            Call("take_end"),
            *self.loops.start("t + h"),
            Call("mass"),
            *self.loops.factors(),
            *self.loops.solve_momentum(),
            Call("jet"),
            *self.at_state(1),
            *map(Call, ("keep_end", "momentum_of_adjoint", "allow_no_change", "solve_held")),
            Call("constrain"),
            *self._slopes(),
            Call("pull_curvature"),
            *self.if_varied(Call("pull_curvature_slopes")),
            *self._carried(Call("pull_carried"), *self.if_varied(Call("pull_carried_slopes"))),
            Call("take_projected"),
            Call("constrain"),
            *self._slopes(),
            Call("pull_projection"),
            *self.if_varied(Call("pull_projection_slopes")),
        )

    def pulled_right(self) -> tuple[Statement, ...]:
        """Add what constraints at a control point contribute to the right side of the adjoint."""
        return self._points("range(DEGREE)", Call("pull_point", ("W", "h", "point", "lane")))

    def adjoint_joined(self) -> tuple[Statement, ...]:
        """Bring equations and the right side of the adjoint into the order of elimination."""
        joined = Call("join_rows", ("W", "ADJOINT_RIGHT", "lane"))
        return self.if_held(Call("join_equations"), joined)

    def adjoint_parted(self) -> tuple[Statement, ...]:
        """Bring the solution back."""
        return self.if_held(Call("part_rows", ("W", "ADJOINT_RIGHT", "lane")))

    def pulled_start(self) -> tuple[Statement, ...]:
        """Add the derivatives by q0 and by parameters that go through control points."""
        here = ("W", "h", "point", "lane")
        points = self._points(
            "range(DEGREE + 1)",
            Call("pull_start_of_point", here),
            *self.if_varied(Call("pull_slopes_of_point", here)),
        )
        return (*points, *self.if_held(*self.if_varied(Call("add_end_slopes"))))

    @staticmethod
    def _of_room(function: str) -> Call:
        return Call(function, ("W", "room", "lane"))


def each(*body: Statement) -> Loop:
    """Go over variations: where dq and dp stand, the room of each, the parameter if it is one's."""
    here = (
        Index("dq", "TANGENT + variation * 2 * DIMENSION"),
        Index("room", "work_row_of(W, variation, lane)"),
        Index("parameter", "parameter_of(W, variation, lane)"),
    )
    return Loop("variation", "range(int(W[TANGENTS, lane]))", (*here, *body))


def _kept(function: str) -> Call:
    return Call(function, ("W", "point", "lane"))
