"""A compiled variational integrator of one system."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from symsimpson.errors import ConvergenceError, InputError, Interrupted
from symsimpson.runtime.inputs import (
    read_array,
    read_every,
    read_number,
    read_parameters,
    read_steps,
    read_vector,
)
from symsimpson.runtime.load import Facts, equations_of, read_facts
from symsimpson.runtime.machine import Run
from symsimpson.runtime.numbers import FLOAT64, Numbers
from symsimpson.runtime.status import Status
from symsimpson.runtime.trajectory import Trajectory

__all__ = ["Stepper"]

#: float64, or numbers of mpmath in an object array.
Reals = NDArray[Any]
Parameters = Mapping[Any, Any]


class Stepper:
    """A variational integrator, ready to run; made by ``compile`` and ``load``.

    Parameters
    ----------
    source : str
        Text of a generated module.
    where : str
        Names it in messages.
    defaults : mapping from str to float, optional
        Parameter values in the module's order, by the names that a user may call them.
    numbers : Numbers, optional
        What to compute with; double precision unless given.

    Attributes
    ----------
    system, scheme : str
    order : int
    coordinates, parameters, invariants : tuple of str
    source : str
    """

    def __init__(
        self,
        source: str,
        where: str,
        *,
        defaults: Mapping[str, float] | None = None,
        numbers: Numbers = FLOAT64,
    ) -> None:
        facts = read_facts(source, where)
        self.source = source
        self._facts: Facts = facts
        self._numbers = numbers
        self._kernels = numbers.kernels(source, facts)
        self.system, self.scheme, self.order = facts.system, facts.scheme, facts.order
        self.coordinates, self.parameters = facts.coordinates, facts.parameters
        self.invariants = facts.invariants
        self._aliases = {name: i for i, name in enumerate(facts.parameters)}
        self._defaults = numbers.read(facts.defaults)
        if defaults is not None:
            self._aliases |= {name: i for i, name in enumerate(defaults)}
            self._defaults = numbers.read(list(defaults.values()))

    @property
    def n(self) -> int:
        """Number of coordinates."""
        return self._facts.n

    def __repr__(self) -> str:
        return f"Stepper({self.system}, {self.scheme}, order {self.order})"

    def integrate(
        self,
        q0: ArrayLike,
        v0: ArrayLike | None = None,
        *,
        p0: ArrayLike | None = None,
        h: Any,
        t_end: Any = None,
        steps: int | None = None,
        t0: Any = 0.0,
        parameters: Parameters | None = None,
        every: int | None = 1,
        on_failure: Literal["raise", "return"] = "raise",
    ) -> Trajectory:
        """Integrate the equations of motion with a fixed step.

        Parameters
        ----------
        q0 : array_like, shape (n,)
            Initial positions, in the order of the coordinates.
        v0, p0 : array_like, shape (n,)
            Initial velocities or conjugate momenta: exactly one of them.
        h : float
            Step; negative to run backwards.
        t_end : float, optional
            Final time, a whole number of steps from ``t0``.
        steps : int, optional
            Number of steps; exactly one of ``t_end`` and ``steps``.
        t0 : float
            Initial time.
        parameters : mapping, optional
            Values by symbol or by name, in place of the defaults.
        every : int or None
            Store each so-many-th state; None stores only the last.
        on_failure : {"raise", "return"}
            Whether a failed step or Ctrl-C raises, or ends the trajectory with its status.

        Returns
        -------
        Trajectory

        Raises
        ------
        InputError
            If the input makes no sense, or M(q0) is not positive definite.
        ConvergenceError
            If a step failed; it carries the trajectory up to there.
        Interrupted
            At Ctrl-C; it carries the trajectory up to there.

        Examples
        --------
        >>> import symsimpson as ss
        >>> pendulum = ss.systems.pendulum()
        >>> run = ss.compile(pendulum).integrate([1.0], v0=[0.0], h=0.05, t_end=10)
        >>> run.q.shape, bool(abs(run.energy_error).max() < 1e-5)
        ((201, 1), True)
        """
        if on_failure not in ("raise", "return"):
            raise InputError(f"on_failure is {on_failure!r}.\nChoose 'raise' or 'return'.")
        with self._numbers.working():
            values = self._values(parameters)
            h, count, t0 = read_steps(h, t_end, steps, t0, self._numbers)
            run = self._new_run(values, h, t0, count, read_every(every))
            self._begin(run, q0, v0, p0)
            interrupted = False
            try:
                run.advance(count)
            except KeyboardInterrupt:
                interrupted = True
            status = Status.INTERRUPTED if interrupted else run.status
            trajectory = self._trajectory(run, count, status, values)
            if status is not Status.SUCCESS and on_failure == "raise":
                self._fail(run, trajectory)
        return trajectory

    def _new_run(self, values: Reals, h: Any, t0: Any, count: int, stride: int) -> Run:
        stored = count // stride + 1 if stride else 1
        try:
            return Run(self._facts, self._kernels, self._numbers, values, h, t0, stride, stored)
        except (MemoryError, ValueError):
            raise InputError(
                f"{stored} stored states of {2 * self.n} numbers do not fit into memory.\n"
                "Store fewer: every=1000, or every=None for the last state only."
            ) from None

    def step(
        self, q: ArrayLike, p: ArrayLike, h: float, parameters: Parameters | None = None
    ) -> tuple[Reals, Reals]:
        """Take one step from (q, p).

        Returns
        -------
        q1, p1 : ndarray, shape (n,)

        Raises
        ------
        InputError, ConvergenceError
            As :meth:`integrate`.
        """
        end = self.integrate(q, p0=p, h=h, steps=1, parameters=parameters, every=None)
        return end.q[0], end.p[0]

    def residual(
        self,
        q0: ArrayLike,
        p0: ArrayLike,
        nodes: ArrayLike,
        h: float,
        parameters: Parameters | None = None,
    ) -> Reals:
        """Evaluate the discrete Euler-Lagrange equations at given nodes.

        Parameters
        ----------
        q0, p0 : array_like, shape (n,)
        nodes : array_like, shape (d, n)
            Control points X_1..X_d of the path; the last is q1.
        h : float
        parameters : mapping, optional

        Returns
        -------
        ndarray, shape (d n,)
            D_k L_d for k = 1..d-1, then p0 + D_0 L_d.
        """
        with self._numbers.working():
            return self._equations(q0, p0, nodes, h, parameters)[0]

    def jacobian(
        self,
        q0: ArrayLike,
        p0: ArrayLike,
        nodes: ArrayLike,
        h: float,
        parameters: Parameters | None = None,
    ) -> Reals:
        """Evaluate the exact Jacobian of :meth:`residual` by the nodes, shape (d n, d n)."""
        with self._numbers.working():
            return self._equations(q0, p0, nodes, h, parameters)[1]

    def energy(self, q: ArrayLike, p: ArrayLike, parameters: Parameters | None = None) -> Reals:
        """Evaluate the Hamiltonian at states of any origin.

        Parameters
        ----------
        q, p : array_like, shape (N, n)
        parameters : mapping, optional

        Returns
        -------
        ndarray, shape (N,)
        """
        numbers, n = self._numbers, self.n
        with numbers.working():
            states = [read_array(name, x, numbers) for name, x in (("q", q), ("p", p))]
            for name, state in zip("qp", states, strict=True):
                if state.ndim != 2 or state.shape != (len(states[0]), n):
                    raise InputError(
                        f"{name} has shape {state.shape}, expected (N, {n}).\n"
                        "Pass one row for each state; q and p of equal length."
                    )
            values = self._values(parameters)
        found = self._evaluate("energy", "ENERGY", 1, states[0], states[1], values)
        energies: Reals = found[:, 0]
        return energies

    def _equations(
        self, q0: ArrayLike, p0: ArrayLike, nodes: ArrayLike, h: float, given: Parameters | None
    ) -> tuple[Reals, Reals]:
        facts, n, numbers = self._facts, self.n, self._numbers
        d = facts.degree
        q = read_vector("q0", q0, self.coordinates, numbers)
        p = read_vector("p0", p0, self.coordinates, numbers)
        h = read_number("h", h, numbers)
        points = read_array("nodes", nodes, numbers)
        if points.shape != (d, n):
            raise InputError(
                f"nodes has shape {points.shape}, expected ({d}, {n}).\n"
                "Pass the inner control points and q1, one row each."
            )
        layout = facts.layout
        run = Run(facts, self._kernels, numbers, self._values(given), h, h * 0, 0, 1)
        run.rows("POSITION", n)[:] = q
        run.rows("MOMENTUM", n)[:] = p
        run.rows("INCREMENT", d * n)[:] = (points - q).ravel()
        prepare, equations = (self._kernels.address(k) for k in ("prepare", "equations"))
        numbers.driver("evaluate")(
            prepare, equations, h, run.W, facts.places, q[None, :], p[None, :],
            layout["RESIDUAL"], numbers.zeros((1, 0)),
        )  # fmt: skip
        residual, jacobian = map(numbers.result, equations_of(facts, run))
        return residual.ravel(), jacobian.reshape(d * n, d * n)

    def _values(self, given: Parameters | None) -> Reals:
        facts = self._facts
        return read_parameters(
            self.parameters, self._aliases, facts.signs, self._defaults, given, self._numbers
        )

    def _begin(self, run: Run, q0: ArrayLike, v0: ArrayLike | None, p0: ArrayLike | None) -> None:
        if (v0 is None) == (p0 is None):
            given = "neither" if v0 is None else "both"
            raise InputError(
                f"a run needs exactly one of v0 and p0, and has {given}.\n"
                "Pass initial velocities v0=[...] or initial momenta p0=[...]."
            )
        numbers = self._numbers
        q = read_vector("q0", q0, self.coordinates, numbers)
        if p0 is not None:
            run.begin(q, read_vector("p0", p0, self.coordinates, numbers), velocity=False)
        elif v0 is not None:
            run.begin(q, read_vector("v0", v0, self.coordinates, numbers), velocity=True)
        deficit = float(run.rows("MASS_PIVOT", 1)[0])
        if deficit < 0 or not numbers.finite(run.rows("VELOCITY", self.n)).all():
            values = dict(
                zip(
                    self.parameters,
                    run.rows("PARAMETER", len(self.parameters)).tolist(),
                    strict=True,
                )
            )
            if numbers.finite(q).all() and (deficit < 0 or not np.isfinite(deficit)):
                raise InputError(
                    f"{self.system}: the mass matrix at q0={q.tolist()} is not positive definite "
                    f"with the parameters {values}.\nKinetic energy must be positive for every "
                    "velocity. Check the masses, and that q0 is not a singular point of the "
                    "coordinates (a pole of spherical angles, say)."
                )
            raise InputError(
                f"{self.system}: the velocity at q0={q.tolist()} is not finite with the "
                f"parameters {values}.\nq0 is a singular point of the coordinates or too large "
                "for them. Begin elsewhere."
            )

    def _trajectory(self, run: Run, count: int, status: Status, values: Reals) -> Trajectory:
        done = run.step
        if run.every:
            kept = done // run.every + 1
            t = run.t0 + self._numbers.counted(0, done + 1, run.every) * run.h
            q, p, iterations = run.q[:kept, :, 0], run.p[:kept, :, 0], run.iterations[:kept, 0]
        else:
            run.store(0)
            t = np.array([run.t0 + run.h * done], dtype=run.q.dtype)
            q, p = run.q[:, :, 0], run.p[:, :, 0]
            iterations = run.rows("ITERATIONS", 1).astype(np.int64)
        message = status.message
        if status is not Status.SUCCESS:
            time, h = float(run.t0 + run.h * done), float(run.h)
            message = (
                f"{self.system}, {self.scheme}: step {done} of {count} at t={time:g} with h={h:g} "
                f"was not taken. {message}"
            )
        t, q, p, values = map(self._numbers.result, (t, q, p, values))
        return Trajectory(
            t=t, q=q, p=p, newton_iterations=iterations, h=run.h, steps=done, status=status,
            message=message,
            _stepper=self, _values=values,
        )  # fmt: skip

    def _fail(self, run: Run, trajectory: Trajectory) -> None:
        status = trajectory.status
        if status is Status.INTERRUPTED:
            raise Interrupted(trajectory.message, trajectory=trajectory)
        residual = run.last_correction
        raise ConvergenceError(
            f"{trajectory.message} The last of {run.last_iterations} iterations changed the step "
            f"by a fraction of {residual:.1e}. The states before are in this error's .trajectory.",
            trajectory=trajectory,
            step=run.step,
            time=float(run.t0 + run.h * run.step),
            residual=residual,
            status=status,
        )

    def _evaluate(
        self, kernel: str, block: str, count: int, q: Reals, p: Reals, values: Reals
    ) -> Reals:
        """Evaluate a kernel of the state at many states; shape (len(q), count)."""
        facts, numbers = self._facts, self._numbers
        with numbers.working():
            W = numbers.zeros((facts.rows, 1))
            first = facts.layout["PARAMETER"]
            W[first : first + values.size, 0] = numbers.read(values)
            out = numbers.zeros((len(q), count))
            numbers.driver("evaluate")(
                self._kernels.address("prepare"), self._kernels.address(kernel),
                numbers.read(1.0).item(), W, facts.places, numbers.read(q), numbers.read(p),
                facts.layout[block], out,
            )  # fmt: skip
            return numbers.result(out)
