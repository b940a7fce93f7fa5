"""Ipopt, as casadi's wheel brings it: the one place that knows of a solver."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from time import perf_counter
from typing import Any, Protocol

import numpy as np

from symsimpson.support.array_types import Floats, Ints
from symsimpson.support.extras import library

__all__ = ["Outcome", "Solvable", "run_ipopt"]


class Solvable(Protocol):
    """A programme as a solver sees it: see :class:`transcription.Programme`."""

    shape: tuple[int, int]  #: Numbers of rows and of unknowns.
    jacobian_places: tuple[Ints, Ints]  #: Rows and columns of the entries of the Jacobian.
    #: Rows and columns of the entries of the Hessian, on and above the diagonal.
    hessian_places: tuple[Ints, Ints]

    def values(self, x: Floats) -> tuple[float, Floats]:
        """Return the cost and the rows."""

    def slopes(self, x: Floats) -> tuple[Floats, Floats]:
        """Return the gradient of the cost, and the entries of the Jacobian."""

    def curvatures(self, x: Floats, cost: float, multipliers: Floats) -> Floats:
        """Return entries of the Hessian of cost times the cost, and multipliers times the rows."""


@dataclass(frozen=True)
class Outcome:
    """The last iterate of a solver, its multipliers, and how it ended, in the solver's words."""

    x: Floats
    multipliers: Floats
    ipopt_status: str
    iterations: int
    seconds: float
    in_functions: float
    history: dict[str, list[float]]


def run_ipopt(
    programme: Solvable,
    x0: Floats,
    bounds: tuple[Floats, Floats],
    limits: tuple[Floats, Floats],
    options: dict[str, Any],
    stopped: Callable[[float], bool],
) -> Outcome:
    """Solve a programme from a guess; ``stopped`` gets the cost of each iterate.

    Raises InputError if casadi is not installed.
    """
    ca = library("casadi", "optimal control", "control")
    rows, size = programme.shape
    spent = 0.0

    def pattern(places: Any, shape: tuple[int, int]) -> Any:
        return ca.Sparsity.triplet(*shape, *(x.tolist() for x in places))

    of_x, of_g, scalar = (ca.Sparsity.dense(k, 1) for k in (size, rows, 1))
    none = ca.Sparsity.dense(0, 1)
    jacobian = pattern(programme.jacobian_places, (rows, size))
    hessian = pattern(programme.hessian_places, (size, size))

    class Part(ca.Callback):  # type: ignore[name-defined]
        """A function of casadi that calls one of ours."""

        def __init__(self, name: str, takes: Any, gives: Any, function: Any) -> None:
            super().__init__()
            self.takes, self.gives, self.function = takes, gives, function
            self.construct(name, {})

        def get_n_in(self) -> int:
            return len(self.takes)

        def get_n_out(self) -> int:
            return len(self.gives)

        def get_sparsity_in(self, i: int) -> Any:
            return self.takes[i]

        def get_sparsity_out(self, i: int) -> Any:
            return self.gives[i]

        def has_eval_buffer(self) -> bool:
            return True  # memory of casadi's, in place of lists of numbers

        def eval_buffer(self, given: Any, results: Any) -> int:
            nonlocal spent
            begin = perf_counter()
            arguments = (np.frombuffer(x if x else b"", dtype=np.float64) for x in given)
            for place, value in zip(results, self.function(*arguments), strict=True):
                if place:  # what is not asked for has none
                    np.frombuffer(place, dtype=np.float64)[:] = value
            spent += perf_counter() - begin
            return 0

    def values_and_slopes(x: Floats, k: int) -> tuple[Any, Any]:
        return programme.values(x)[k], programme.slopes(x)[k]

    def curved(x: Floats, p: Floats, cost: Floats, multipliers: Floats) -> tuple[Any, ...]:
        return (programme.curvatures(x, float(cost[0]), multipliers),)

    class Watch(ca.Callback):  # type: ignore[name-defined]
        """A function that casadi calls behind each iteration."""

        def __init__(self) -> None:
            super().__init__()
            self.of_cost = ca.nlpsol_out().index("f")
            self.construct("watch", {})

        def get_n_in(self) -> int:
            return int(ca.nlpsol_n_out())

        def get_n_out(self) -> int:
            return 1

        def get_sparsity_in(self, i: int) -> Any:
            kinds = {"f": scalar, "x": of_x, "lam_x": of_x, "g": of_g, "lam_g": of_g}
            return kinds.get(ca.nlpsol_out(i), none)

        def eval(self, given: Any) -> Any:
            return [int(stopped(float(given[self.of_cost])))]

    x = ca.MX.sym("x", size)
    at = [of_x, none]
    nlp = Part("nlp", at, [scalar, of_g], lambda x, p: programme.values(x))
    parts = {
        "grad_f": Part("grad_f", at, [scalar, of_x], lambda x, p: values_and_slopes(x, 0)),
        "jac_g": Part("jac_g", at, [of_g, jacobian], lambda x, p: values_and_slopes(x, 1)),
        "hess_lag": Part("hess_lag", [*at, scalar, of_g], [hessian], curved),
    }
    watching = Watch()
    f, g = nlp(x, ca.MX(0, 1))
    solver = ca.nlpsol(
        "solver",
        "ipopt",
        {"x": x, "f": f, "g": g},
        {
            "ipopt": options,
            "print_time": False,
            "show_eval_warnings": False,
            "error_on_fail": False,
            "inputs_check": False,  # it prints a line where inputs are fixed and rows repeat
            "no_nlp_grad": True,
            "iteration_callback": watching,
            "iteration_callback_ignore_errors": False,
            **parts,
        },
    )
    begin = perf_counter()
    solution = solver(x0=x0, lbx=bounds[0], ubx=bounds[1], lbg=limits[0], ubg=limits[1])
    seconds = perf_counter() - begin
    stats = solver.stats()
    return Outcome(
        np.array(solution["x"]).ravel(),
        np.array(solution["lam_g"]).ravel(),
        str(stats["return_status"]),
        int(stats.get("iter_count", 0)),
        seconds,
        spent,
        {name: list(map(float, values)) for name, values in stats.get("iterations", {}).items()},
    )
