"""Constraints in kernels that differentiate a step: at control points, and at its end."""

from __future__ import annotations

from symsimpson.codegen.differentials import Differentials
from symsimpson.codegen.ir import Call, Loop, Statement

__all__ = ["HeldDifferentials"]

_ONE = ("W", "variation", "lane")
_AT_POINT = ("W", "h", "point", "variation", "lane")
_OF_ONE = ("W", "constraint", "variation", "lane")


class HeldDifferentials(Differentials):
    """Makes these parts; without constraints each of them is empty."""

    def if_held(self, *statements: Statement) -> tuple[Statement, ...]:
        """Return statements where there are constraints."""
        return statements if self.loops.held else ()

    def at_points(self) -> tuple[Statement, ...]:
        """Add what constraints at a control point contribute to the right sides."""
        varied = self.if_varied(Call("add_constraint_slopes", _AT_POINT))
        return self.if_held(*self._slopes(), each(Call("vary_constraint", _AT_POINT), *varied))

    def joined(self) -> tuple[Statement, ...]:
        """Bring equations and right sides into the order of elimination."""
        return self.if_held(Call("join_equations"), each(self._of_room("join_rows")))

    def parted(self) -> tuple[Statement, ...]:
        """Bring solutions back into the order of increments and multipliers."""
        return self.if_held(each(self._of_room("part_rows")))

    def pulls(self) -> tuple[Statement, ...]:
        """Add what the pulls of constraints change by to dp1 - dp0."""
        varied = self.if_varied(Call("add_pull_slopes", ("W", "h", "variation", "lane")))
        moved = each(Call("vary_pull", _AT_POINT), *varied)
        return self.loops.points("range(DEGREE)", "constrain", *self._slopes(), moved)

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
                    Call("vary_curvature", _OF_ONE),
                    *self.if_varied(Call("add_curvature_slopes", _OF_ONE)),
                ),
            ),
        )
        taken = map(Call, ("momentum_taken", "allow_no_change", "solve_held", "constrain"))
        begun = each(
            Call("begin_projection", _ONE), *self.if_varied(Call("add_projection_slopes", _ONE))
        )
        closed = each(
            Call("take_right_side", _ONE),
            Call("solve_held"),
            Call("close_projection", _ONE),
            *self.if_varied(Call("add_momentum_slopes", _ONE)),
        )
        return (
            *self.loops.start("t + h"),
            Call("mass"),
            *self.loops.factors(),
            *self.loops.solve_momentum(),
            Call("jet"),
            *self.if_varied(Call("parameter_slopes")),
            curvature,
            *taken,
            *self._slopes(),
            begun,
            closed,
            *self.loops.solve_momentum(),
        )

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
            *self.if_varied(Call("parameter_slopes")),
            *map(Call, ("keep_end", "momentum_of_adjoint", "allow_no_change", "solve_held")),
            Call("constrain"),
            *self._slopes(),
            Call("pull_curvature"),
            *self.if_varied(Call("pull_curvature_slopes")),
            Call("take_projected"),
            Call("constrain"),
            *self._slopes(),
            Call("pull_projection"),
            *self.if_varied(Call("pull_projection_slopes")),
        )

    def pulled_right(self) -> tuple[Statement, ...]:
        """Add what constraints at a control point contribute to the right side of the adjoint."""
        return self.if_held(Call("pull_point", ("W", "h", "point", "lane")))

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
        found = self.loops.points(
            "range(DEGREE + 1)",
            "constrain",
            *self._slopes(),
            Call("pull_start_of_point", here),
            *self.if_varied(Call("pull_slopes_of_point", here)),
        )
        return (*found, *self.if_held(*self.if_varied(Call("add_end_slopes"))))

    @staticmethod
    def _of_room(function: str) -> Call:
        return Call(function, ("W", "room_of(W, variation, lane)", "lane"))


def each(*body: Statement) -> Loop:
    """Go over variations."""
    return Loop("variation", "range(int(W[TANGENTS, lane]))", body)
