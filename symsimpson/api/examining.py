"""Derivatives of steps and runs, Poincaré sections, reports, C export and certificates."""

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
from symsimpson.run.gradients import GradientArguments, gradient_of
from symsimpson.run.lyapunov import lyapunov
from symsimpson.run.requested import take_step_with_tangents
from symsimpson.run.step_equations import linearise
from symsimpson.stepping.inputs import read_variables
from symsimpson.stepping.request import Request, step_request
from symsimpson.support.array_types import Reals
from symsimpson.support.calling import explain_methods
from symsimpson.support.derivation import Report

if TYPE_CHECKING:
    from symsimpson.results.events import Events
    from symsimpson.stepping.event import Event
    from symsimpson.study.analysis.certificate import Certificate


@explain_methods()
class Analyser(Evaluator):
    """The part of a stepper that differentiates and examines steps and runs."""

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
        """Take one step and differentiate it.

        Parameters
        ----------
        q : array_like, shape (n,)
            Positions at the start of the step.
        v, p : array_like, shape (n,), optional
            Velocities or conjugate momenta at the start of the step. Pass exactly one of them.
        h : float
            Step size, in the unit of time.
        wrt : str, symbol or sequence of them, default ("q", "p")
            Variables to differentiate by. "q" and "p" are the positions and momenta at the start
            of the step, "h" is the step size, and "t" is the initial time. Parameters and inputs
            have their names or symbols. An input is varied equally at all nodes.
        t, inputs, parameters
            The same arguments as for :meth:`step`.

        Returns
        -------
        q1, p1 : ndarray, shape (n,)
            Positions and conjugate momenta at the end of the step.
        D : ndarray, shape (2 n, k)
            Derivatives of (q1, p1). "q" and "p" have n columns each, every other name has one. If
            you pass ``v``, derivatives by parameters are taken at fixed v, else at fixed p.

        Raises
        ------
        InputError
            If an argument is invalid.
        ConvergenceError
            If the step fails.
        SchemeError
            If steps of this scheme or system cannot be differentiated.

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
        names = read_variables(self.program, varied)
        request = step_request(q, v, p, h, t, parameters, inputs)
        end = take_step_with_tangents(self.program, request._replace(tangents=2 * n), names)
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

        The derivatives of the computed cost are exact up to round-off. The discrete adjoint of
        each step carries them from the end of the run to its start. A gradient takes two or three
        times as long as the run, for any number of parameters and inputs. The method stores steps,
        or recomputes them, so that memory stays below about 100 MB.

        Parameters
        ----------
        q0, v0, p0, h, t_end, steps, t0, parameters, inputs
            The same arguments as for :meth:`integrate`.
        cost : SymPy expression or str, optional
            Cost of the final state, in coordinates, velocities, momenta and parameters.
            :meth:`Trajectory.events` describes the expressions.
        running : SymPy expression, optional
            Cost that the quadrature of the scheme integrates along the path. It may contain
            coordinates, velocities, parameters, inputs and the time.
        samples : mapping from expression to array_like, shape (N // every + 1,), optional
            Measured values of expressions (as for ``cost``), at the initial state and after every
            ``every`` steps. NaN marks missing values. The cost includes the sum of the squared
            differences between the run and the samples.
        every : int, default 1
            Number of steps between samples.
        wrt : str, symbol or sequence of them
            Variables to differentiate by: "q", and "v" or "p" (whichever you pass), are the initial
            state. Parameters and inputs have their names or symbols. "h" is the size of all steps,
            and "t" is t0. If nothing depends on the time, "h" is t_end / steps.
        progress : bool, optional
            Whether to show a progress bar, as for :meth:`integrate`.

        Returns
        -------
        Gradient
            The pair (value, gradient) that ``scipy.optimize.minimize(..., jac=True)`` takes. Its
            attribute ``parts`` has the derivatives by name. The derivatives by an input have the
            shape of the values that you pass.

        Raises
        ------
        InputError
            If an argument is invalid.
        ConvergenceError
            If a step fails.
        Interrupted
            If you press Ctrl-C.
        ModelError
            If ``running`` contains an unknown symbol or function.
        SchemeError
            If steps of this scheme or system cannot be differentiated.

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
        wanted = GradientArguments(cost, running, samples, every, wrt)
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
        """Integrate, and differentiate each step by its initial state and by its inputs.

        The derivatives are the matrices of the linear system z_{k+1} = A_k z_k + B_k u_k along the
        run. They are exact up to round-off. Use them to design controllers and observers.

        Parameters
        ----------
        q0, v0, p0, h, t_end, steps, t0, parameters, inputs
            The same arguments as for :meth:`integrate`.
        wrt : str, symbol or sequence of them, default ()
            Parameters and inputs to differentiate by, besides the state. "h" is the size of each
            step, and "t" is the time at its start.
        progress : bool, optional
            Whether to show a progress bar, as for :meth:`integrate`.

        Returns
        -------
        Linearisation
            The states, and the derivatives of each step by the state, by parameters, and by the
            values of the inputs at the nodes.

        Raises
        ------
        InputError
            If an argument is invalid.
        ConvergenceError
            If a step fails.
        Interrupted
            If you press Ctrl-C.
        SchemeError
            If steps of this scheme or system cannot be differentiated.

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
        """Integrate, and compute Lyapunov exponents and other indicators of chaos.

        The exact derivatives of the steps propagate variations of the state, which are
        orthonormalised every ``every`` steps. Without friction, the sum of all exponents is zero
        up to round-off. With constraints, the exponents are those of the constrained phase space.

        Parameters
        ----------
        q0, v0, p0, h, t_end, steps, t0, parameters, inputs
            The same arguments as for :meth:`integrate`.
        exponents : int, optional
            Number of exponents, the largest ones. By default all: two for each degree of freedom.
        every : int, default 20
            Number of steps between two orthonormalisations of the variations.
        progress : bool, optional
            Whether to show a progress bar, as for :meth:`integrate`.

        Returns
        -------
        Chaos
            Lyapunov exponents, MEGNO, SALI and GALI, during the run and at its end.

        Raises
        ------
        InputError
            If an argument is invalid.
        ConvergenceError
            If a step fails.
        Interrupted
            If you press Ctrl-C.
        SchemeError
            If steps of this scheme or system cannot be differentiated.

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
        """Report the time that deriving and compiling took, and the size of the generated code.

        Returns
        -------
        Report
            The seconds of each stage, the lines of code and the number of operations. "reading" is
            the parsing of T and V, "structure" is their analysis, "jet" is the derivation of L at a
            node, and "text" is the module. "compilation" includes the kernels used so far.

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
        """Integrate, and store only the states at the zeros of an expression: a Poincaré section.

        The run takes the same steps as :meth:`integrate`.

        Parameters
        ----------
        expression, direction, wrap
            The same arguments as for :meth:`Trajectory.events`.
        q0, v0, p0, h, t_end, steps, t0, parameters, inputs, events, progress, on_failure
            The same arguments as for :meth:`integrate`.

        Returns
        -------
        Events
            The states at the zeros.

        Raises
        ------
        InputError
            If an argument is invalid.
        ConvergenceError
            If a step fails. Its attribute ``trajectory`` has the zeros found so far.
        Interrupted
            If you press Ctrl-C. Its attribute ``trajectory`` has the zeros found so far.

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
        """Write the steps as a C99 header and source file, for programs without Python.

        The code needs only functions of ``<math.h>`` and allocates no memory. Inputs are constant
        during a step. The states equal those of :meth:`integrate` up to round-off.

        Parameters
        ----------
        path : path
            Path of both files without an extension. Its last part is the prefix of all public
            names in the C code.

        Returns
        -------
        tuple of pathlib.Path
            The paths of the header and of the source file.

        Raises
        ------
        InputError
            If the name is not a C identifier, the stepper has a ``precision``, or the system has a
            time transformation.
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

        `certify` measures all properties on the generated source with 50 digits. It then compares
        the compiled code with this source.

        Parameters
        ----------
        q0 : array_like, shape (n,), optional
            Positions at which to measure. By default, `certify` takes the reference state of the
            system, or a random state.
        v0, p0 : array_like, shape (n,), optional
            Velocities or conjugate momenta at which to measure.
        h : float, optional
            Step size, in the unit of time. By default, `certify` finds one by trial.
        parameters : mapping, optional
            Values of the parameters, by symbol or name. By default, those of the declaration.
        inputs : mapping, optional
            A constant value for each input, by symbol or name. By default 1.

        Returns
        -------
        Certificate
            Prints as a table with a verdict in each row. ``.passed`` is the overall verdict.

        Raises
        ------
        InputError
            If an argument is invalid. Also if forces act and the stepper was loaded from a file,
            because the file does not describe the forces.

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
                "this stepper cannot be certified, because it belongs to a stored result.",
                where=self.system,
                remedy="Certify a stepper from symsimpson.compile or symsimpson.load.",
            )
        return tools.certify(self, q0, v0, p0=p0, h=h, parameters=parameters, inputs=inputs)
