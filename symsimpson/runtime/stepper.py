"""A compiled variational integrator of one system."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from symsimpson.errors import ConvergenceError, InputError, Interrupted
from symsimpson.runtime.inputs import (
    read_every,
    read_floats,
    read_number,
    read_parameters,
    read_steps,
    read_vector,
)
from symsimpson.runtime.load import Facts, Kernels, equations_of, read_facts
from symsimpson.runtime.machine import Run, driver
from symsimpson.runtime.status import Status
from symsimpson.runtime.trajectory import Trajectory

__all__ = ["Stepper"]

Floats = NDArray[np.float64]
Parameters = Mapping[Any, float]


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

    Attributes
    ----------
    system, scheme : str
    order : int
    coordinates, parameters, invariants : tuple of str
    source : str
    """

    def __init__(
        self, source: str, where: str, *, defaults: Mapping[str, float] | None = None
    ) -> None:
        facts = read_facts(source, where)
        self.source = source
        self._facts: Facts = facts
        self._kernels = Kernels(source, facts)
        self.system, self.scheme, self.order = facts.system, facts.scheme, facts.order
        self.coordinates, self.parameters = facts.coordinates, facts.parameters
        self.invariants = facts.invariants
        self._aliases = {name: i for i, name in enumerate(facts.parameters)}
        self._defaults = np.array(facts.defaults, dtype=np.float64)
        if defaults is not None:
            self._aliases |= {name: i for i, name in enumerate(defaults)}
            self._defaults = np.array(list(defaults.values()), dtype=np.float64)

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
        h: float,
        t_end: float | None = None,
        steps: int | None = None,
        t0: float = 0.0,
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
        facts = self._facts
        h, count, t0 = read_steps(h, t_end, steps, t0)
        stride = read_every(every)
        if on_failure not in ("raise", "return"):
            raise InputError(f"on_failure is {on_failure!r}.\nChoose 'raise' or 'return'.")
        values = self._values(parameters)
        stored = count // stride + 1 if stride else 1
        try:
            run = Run(facts, self._kernels, values, h, t0, stride, stored)
        except (MemoryError, ValueError):
            raise InputError(
                f"{stored} stored states of {2 * self.n} numbers do not fit into memory.\n"
                "Store fewer: every=1000, or every=None for the last state only."
            ) from None
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

    def step(
        self, q: ArrayLike, p: ArrayLike, h: float, parameters: Parameters | None = None
    ) -> tuple[Floats, Floats]:
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
    ) -> Floats:
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
        return self._equations(q0, p0, nodes, h, parameters)[0]

    def jacobian(
        self,
        q0: ArrayLike,
        p0: ArrayLike,
        nodes: ArrayLike,
        h: float,
        parameters: Parameters | None = None,
    ) -> Floats:
        """Evaluate the exact Jacobian of :meth:`residual` by the nodes, shape (d n, d n)."""
        return self._equations(q0, p0, nodes, h, parameters)[1]

    def _equations(
        self, q0: ArrayLike, p0: ArrayLike, nodes: ArrayLike, h: float, given: Parameters | None
    ) -> tuple[Floats, Floats]:
        facts, n = self._facts, self.n
        d = facts.degree
        q = read_vector("q0", q0, self.coordinates)
        p = read_vector("p0", p0, self.coordinates)
        h = read_number("h", h)
        points = read_floats("nodes", nodes)
        if points.shape != (d, n):
            raise InputError(
                f"nodes has shape {points.shape}, expected ({d}, {n}).\n"
                "Pass the inner control points and q1, one row each."
            )
        layout = facts.layout
        run = Run(facts, self._kernels, self._values(given), h, 0.0, 0, 1)
        run.rows("POSITION", n)[:] = q
        run.rows("MOMENTUM", n)[:] = p
        run.rows("INCREMENT", d * n)[:] = (points - q).ravel()
        prepare, equations = (self._kernels.address(k) for k in ("prepare", "equations"))
        driver("evaluate")(
            prepare, equations, h, run.W, facts.places, q[None, :], p[None, :],
            layout["RESIDUAL"], np.empty((1, 0)),
        )  # fmt: skip
        residual, jacobian = equations_of(facts, run)
        return residual.ravel(), jacobian.reshape(d * n, d * n)

    def _values(self, given: Parameters | None) -> Floats:
        facts = self._facts
        return read_parameters(self.parameters, self._aliases, facts.signs, self._defaults, given)

    def _begin(self, run: Run, q0: ArrayLike, v0: ArrayLike | None, p0: ArrayLike | None) -> None:
        if (v0 is None) == (p0 is None):
            given = "neither" if v0 is None else "both"
            raise InputError(
                f"a run needs exactly one of v0 and p0, and has {given}.\n"
                "Pass initial velocities v0=[...] or initial momenta p0=[...]."
            )
        q = read_vector("q0", q0, self.coordinates)
        if p0 is not None:
            run.begin(q, read_vector("p0", p0, self.coordinates), velocity=False)
        elif v0 is not None:
            run.begin(q, read_vector("v0", v0, self.coordinates), velocity=True)
        deficit = run.rows("MASS_PIVOT", 1)[0]
        if deficit < 0 or not np.isfinite(run.rows("VELOCITY", self.n)).all():
            values = dict(
                zip(
                    self.parameters,
                    run.rows("PARAMETER", len(self.parameters)).tolist(),
                    strict=True,
                )
            )
            if np.isfinite(q).all() and (deficit < 0 or not np.isfinite(deficit)):
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

    def _trajectory(self, run: Run, count: int, status: Status, values: Floats) -> Trajectory:
        done = run.step
        if run.every:
            kept = done // run.every + 1
            t = run.t0 + run.h * np.arange(0, done + 1, run.every, dtype=np.float64)
            q, p, iterations = run.q[:kept, :, 0], run.p[:kept, :, 0], run.iterations[:kept, 0]
        else:
            run.store(0)
            t = np.array([run.t0 + run.h * done])
            q, p = run.q[:, :, 0], run.p[:, :, 0]
            iterations = run.rows("ITERATIONS", 1).astype(np.int64)
        message = status.message
        if status is not Status.SUCCESS:
            message = (
                f"{self.system}, {self.scheme}: step {done} of {count} at "
                f"t={run.t0 + run.h * done:g} with h={run.h:g} was not taken. {message}"
            )
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
            time=run.t0 + run.h * run.step,
            residual=residual,
            status=status,
        )

    def _evaluate(
        self, kernel: str, block: str, count: int, q: Floats, p: Floats, values: Floats
    ) -> Floats:
        """Evaluate a kernel of the state at many states; shape (len(q), count)."""
        facts = self._facts
        W = np.zeros((facts.rows, 1))
        first = facts.layout["PARAMETER"]
        W[first : first + values.size, 0] = values
        out = np.empty((len(q), count))
        driver("evaluate")(
            self._kernels.address("prepare"), self._kernels.address(kernel), 1.0, W, facts.places,
            q, p, facts.layout[block], out,
        )  # fmt: skip
        return out
