"""Findings about steps or runs: derivatives, sections, certificates."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from numpy.typing import ArrayLike

from symsimpson.api.evaluator import Evaluator, Parameters
from symsimpson.errors import reject
from symsimpson.program.program import report_of
from symsimpson.results.motion_derivatives import Chaos, Gradient, Linearisation
from symsimpson.run.gradients import Wanted, gradient_of
from symsimpson.run.lyapunov import lyapunov
from symsimpson.run.requested import tangent_of_step
from symsimpson.run.step_equations import linearise
from symsimpson.stepping.inputs import read_varied
from symsimpson.stepping.request import Request, step_request
from symsimpson.support.array_types import Reals
from symsimpson.support.calling import explaining
from symsimpson.support.derivation import Report

if TYPE_CHECKING:
    from symsimpson.results.events import Events
    from symsimpson.stepping.event import Event
    from symsimpson.study.analysis.certificate import Certificate


@explaining()
class Examining(Evaluator):
    """Exact derivatives of steps or runs, sections, the report and the certificate of a stepper."""

    def tangent(
        self,
        q: ArrayLike,
        v: ArrayLike | None = None,
        *,
        p: ArrayLike | None = None,
        h: Any,
        wrt: str | Sequence[Any] = ("q", "p"),
        t: Any = 0.0,
        inputs: Any = None,
        parameters: Parameters | None = None,
    ) -> tuple[Reals, Reals, Reals]:
        """Take one step, and differentiate it.

        Parameters
        ----------
        q, v, p : array_like, shape (n,)
            One of ``v`` and ``p`` is left out.
        h : float
        wrt : sequence of str or symbols
            "q" and "p" for positions and momenta at the start, names or symbols of parameters and
            inputs, "h" and "t". Of an input it is the same change at all nodes.
        t, inputs, parameters
            As for :meth:`step`.

        Returns
        -------
        q1, p1 : ndarray, shape (n,)
        D : ndarray, shape (2 n, k)
            Derivatives of (q1, p1), with n columns for each of "q" and "p" and one for each name.
            Those by parameters are at given v where that was given.

        Raises
        ------
        InputError, ConvergenceError
            As :meth:`integrate`.
        SchemeError
            If steps of the scheme, or of the system, are not differentiated.

        Examples
        --------
        >>> import numpy as np, symsimpson as ss
        >>> stepper = ss.compile(ss.systems.pendulum())
        >>> q1, p1, D = stepper.tangent([1.0], p=[0.0], h=0.01, wrt=("q", "p", "l"))
        >>> D.shape, round(float(np.linalg.det(D[:, :2])), 12)
        ((2, 3), 1.0)
        """
        n, given = self.n, tuple(wrt) if isinstance(wrt, (list, tuple)) else (wrt,)
        varied = [name for name in given if not (isinstance(name, str) and name in ("q", "p"))]
        names = read_varied(self.program, varied, of_steps=True)
        request = step_request(q, v, p, h, t, parameters, inputs)
        end = tangent_of_step(self.program, request._replace(tangents=2 * n), names)
        assert end.variations is not None
        D = end.variations[0]
        places = {"q": range(n), "p": range(n, 2 * n)}
        columns: list[int] = []
        for name in given:
            state = places.get(name) if isinstance(name, str) else None
            columns += state or [2 * n + varied.index(name)]
        return end.q[0], end.p[0], D[:, columns]

    def gradient(
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
        inputs: Any = None,
        cost: Any = None,
        running: Any = None,
        samples: Mapping[Any, ArrayLike] | None = None,
        every: int = 1,
        wrt: str | Sequence[Any],
        progress: bool | None = None,
    ) -> Gradient:
        """Integrate, and differentiate a cost of the run by any number of variables.

        The derivatives of the computed cost are exact to rounding: they are carried backwards by
        the discrete adjoint of each step. This takes two or three times as long as the run, for
        any number of parameters and inputs. Steps are stored, or computed again, so that memory
        stays below some 100 MB.

        Parameters
        ----------
        q0, v0, p0, h, t_end, steps, t0, parameters, inputs
            As for :meth:`integrate`.
        cost : SymPy expression or str, optional
            Of the last state: in coordinates, velocities, momenta and parameters, as
            :meth:`Trajectory.events` takes them.
        running : SymPy expression, optional
            A cost that is integrated along the path by the scheme's quadrature; in coordinates,
            velocities, parameters, inputs and the time.
        samples : mapping from expression to array_like, shape (N // every + 1,), optional
            Measured values of an expression as in ``cost``, at the first state and after each
            ``every`` steps, NaN where there are none. The sum of the squared differences between
            run and samples is added to the cost.
        every : int
            Steps between samples.
        wrt : str, symbol or sequence of them
            "q" and, as it was given, "v" or "p" of the initial state; parameters; inputs; "h" of
            all steps, that is t_end / steps where nothing depends on the time, and "t", that is t0.
        progress : bool, optional
            As for :meth:`integrate`.

        Returns
        -------
        Gradient
            The pair (value, gradient) that ``scipy.optimize.minimize(..., jac=True)`` takes; its
            ``parts`` have the derivatives by name, of an input in the shape in which it was given.

        Raises
        ------
        InputError, ConvergenceError, Interrupted
            As :meth:`integrate`.
        ModelError
            If ``running`` contains something else.
        SchemeError
            If steps of the scheme, or of the system, are not differentiated.

        Examples
        --------
        >>> import symsimpson as ss
        >>> pendulum = ss.systems.pendulum()
        >>> (theta,) = pendulum.coordinates
        >>> found = ss.compile(pendulum).gradient([1.0], v0=[0.0], h=0.01, t_end=2.0,
        ...     running=theta**2, wrt=("q", "v", "l"))
        >>> found.gradient.shape, sorted(found.parts)
        ((3,), ['l', 'q', 'v'])
        """
        request = Request(q0, v0, p0, h, t_end, steps, t0, parameters, inputs)
        wanted = Wanted(cost, running, samples, every, wrt)
        return gradient_of(self.program, request, wanted, progress)

    def linearise(
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
        inputs: Any = None,
        wrt: str | Sequence[Any] = (),
        progress: bool | None = None,
    ) -> Linearisation:
        """Integrate, and differentiate each step by its start and by the inputs at its nodes.

        These are the matrices of the linear system z_{k+1} = A_k z_k + B_k u_k along the run, exact
        to rounding, as controllers and observers are designed with.

        Parameters
        ----------
        q0, v0, p0, h, t_end, steps, t0, parameters, inputs
            As for :meth:`integrate`.
        wrt : str, symbol or sequence of them
            Parameters and inputs to differentiate by, besides the state; "h" and "t" of each step.
        progress : bool, optional
            As for :meth:`integrate`.

        Returns
        -------
        Linearisation
            States, and derivatives by them, by parameters, and by the values of inputs at nodes.

        Raises
        ------
        InputError, ConvergenceError, Interrupted
            As :meth:`integrate`.
        SchemeError
            If steps of the scheme, or of the system, are not differentiated.

        Examples
        --------
        >>> import numpy as np, symsimpson as ss
        >>> run = ss.compile(ss.systems.pendulum()).linearise([1.0], p0=[0.0], h=0.01, steps=3)
        >>> run.by_state.shape, np.round(np.linalg.det(run.by_state), 12).tolist()
        ((3, 2, 2), [1.0, 1.0, 1.0])
        """
        request = Request(q0, v0, p0, h, t_end, steps, t0, parameters, inputs)
        return linearise(self.program, request, wrt, progress)

    def lyapunov(
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
        inputs: Any = None,
        exponents: int | None = None,
        every: int = 20,
        progress: bool | None = None,
    ) -> Chaos:
        """Integrate with variations of the state, and compute Lyapunov exponents and the like.

        The variations are propagated by the exact derivatives of the steps, and orthonormalized
        every ``every`` steps. Without friction the sum of all exponents is zero to rounding. With
        constraints the exponents are those of the constrained phase space.

        Parameters
        ----------
        q0, v0, p0, h, t_end, steps, t0, parameters, inputs
            As for :meth:`integrate`.
        exponents : int, optional
            How many, the largest ones; all unless given, two for each degree of freedom.
        every : int
            Steps from one time at which variations are made orthonormal to the next.
        progress : bool, optional
            As for :meth:`integrate`.

        Returns
        -------
        Chaos
            Lyapunov exponents, MEGNO, SALI and GALI, at the end and on the way.

        Raises
        ------
        InputError, ConvergenceError, Interrupted
            As :meth:`integrate`.
        SchemeError
            If steps of the scheme, or of the system, are not differentiated.

        Examples
        --------
        >>> import symsimpson as ss
        >>> stepper = ss.compile(ss.systems.double_pendulum())
        >>> chaos = stepper.lyapunov([2.0, 2.5], p0=[0, 0], h=0.01, t_end=20)
        >>> chaos.exponents.shape, bool(chaos.exponents[0] > 1), bool(chaos.sali[-1] < 1e-12)
        ((4,), True, True)
        """
        request = Request(q0, v0, p0, h, t_end, steps, t0, parameters, inputs)
        return lyapunov(self.program, request, exponents, every, progress)

    def report(self) -> Report:
        """Say how long deriving and compiling took, and how long the result is.

        Returns
        -------
        Report
            Seconds for each stage: reading T and V, structure, jet (derivatives at a node), text,
            compiling or loading the kernels used so far. Also lines of code and operations.

        Examples
        --------
        >>> import symsimpson as ss
        >>> report = ss.compile(ss.systems.double_pendulum()).report()
        >>> report.form, report.operations < 35, list(report.seconds)
        ('unrolled', True, ['reading', 'structure', 'jet', 'text', 'compilation'])
        """
        return report_of(self.program)

    def poincare(
        self,
        expression: Any,
        q0: ArrayLike,
        v0: ArrayLike | None = None,
        *,
        p0: ArrayLike | None = None,
        h: float,
        t_end: float | None = None,
        steps: int | None = None,
        t0: float = 0.0,
        direction: int = 0,
        wrap: Any = (),
        parameters: Parameters | None = None,
        inputs: Any = None,
        events: Sequence[Event] | None = None,
        progress: bool | None = None,
        on_failure: Literal["raise", "return"] = "raise",
    ) -> Events:
        """Integrate, and keep only the states in which an expression becomes zero.

        Parameters
        ----------
        expression, direction, wrap
            As for :meth:`Trajectory.events`.
        q0, v0, p0, h, t_end, steps, t0, parameters, inputs, events, progress, on_failure
            As for :meth:`integrate`. The steps of the run are those of :meth:`integrate`.

        Returns
        -------
        Events

        Raises
        ------
        InputError, ConvergenceError, Interrupted
            As :meth:`integrate`; the ``trajectory`` of the last two are the events so far.

        Examples
        --------
        >>> import symsimpson as ss
        >>> stepper = ss.compile(ss.systems.henon_heiles(), scheme="gauss8")
        >>> section = stepper.poincare("x", [0, 0.1], v0=[0.4, 0], h=0.25, steps=20_000,
        ...                            direction=1)
        >>> bool(len(section) > 700), bool(abs(section["x"]).max() < 1e-15)
        (True, True)
        """
        from symsimpson.results.events import read_zeros
        from symsimpson.run.chosen import poincare

        request = Request(q0, v0, p0, h, t_end, steps, t0, parameters, inputs, events=events)
        wanted = read_zeros(self.program, expression, direction, wrap)
        return poincare(self.program, request, wanted, progress, on_failure)

    def export_c(self, path: str | os.PathLike[str]) -> tuple[Path, Path]:
        """Write the steps in C99, for programs without Python: a header and a source file.

        They ask for nothing but functions of ``<math.h>``; nothing is allocated. A step takes the
        inputs that it is given, held over it. States are those of :meth:`integrate` to rounding.

        Parameters
        ----------
        path : path
            Of both files, without an ending; its name begins all names of C that they define.

        Returns
        -------
        tuple of pathlib.Path
            The header and the source.

        Raises
        ------
        InputError
            If the name is none of C; if the stepper has many digits, or a time of its own.
        StorageError
            If a file cannot be written.

        Examples
        --------
        >>> import pathlib, tempfile, symsimpson as ss
        >>> stepper = ss.compile(ss.systems.pendulum())
        >>> header, source = stepper.export_c(pathlib.Path(tempfile.mkdtemp()) / "swing")
        >>> header.name, source.name, "int swing_step(" in header.read_text()
        ('swing.h', 'swing.c', True)
        """
        from symsimpson.targets.c.source import write_files

        return write_files(self.program, path)

    def certify(
        self,
        q0: ArrayLike | None = None,
        v0: ArrayLike | None = None,
        *,
        p0: ArrayLike | None = None,
        h: float | None = None,
        parameters: Parameters | None = None,
        inputs: Mapping[Any, float] | None = None,
    ) -> Certificate:
        """Verify by measurement that this stepper has the properties of its scheme.

        All are measured in 50 digits on its source, which compiled code is then compared with.

        Parameters
        ----------
        q0, v0, p0 : array_like, shape (n,), optional
            The state to measure at; the system's reference state, or a random one, if left out.
        h : float, optional
            The step; found by trial if left out.
        parameters : mapping, optional
        inputs : mapping, optional
            A constant value for each input; 1 by default.

        Returns
        -------
        Certificate
            Prints as a table with a verdict in each row; ``.passed`` is the overall verdict.

        Raises
        ------
        InputError
            If the input makes no sense, or forces act and the stepper is of a file that is by
            itself.

        Examples
        --------
        >>> import symsimpson as ss
        >>> certificate = ss.compile(ss.systems.pendulum()).certify()
        >>> certificate.passed, round(certificate["order"].measured, 1)
        (True, 4.0)
        """
        tools = self.program.tools
        if tools is None:
            reject(
                f"this stepper of {self.system} came with a stored result: it has no certificate.",
                remedy="Certify one that symsimpson.compile or symsimpson.load made.",
            )
        return tools.certify(self, q0, v0, p0=p0, h=h, parameters=parameters, inputs=inputs)
