"""Examinations by a stepper: certificates, and findings in runs that are not kept."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from numpy.typing import ArrayLike

from symsimpson.api.derivatives import Differentiating
from symsimpson.api.evaluator import Parameters
from symsimpson.errors import InputError
from symsimpson.program.program import report_of
from symsimpson.stepping.request import Request
from symsimpson.support.calling import explaining
from symsimpson.support.derivation import Report

if TYPE_CHECKING:
    from symsimpson.results.events import Events
    from symsimpson.stepping.event import Event
    from symsimpson.study.analysis.certificate import Certificate


@explaining()
class Examining(Differentiating):
    """The report, the certificate and sections of a stepper."""

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
        from symsimpson.targets.c.written import write_files

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
            raise InputError(
                f"this stepper of {self.system} came with a stored result: it has no certificate.\n"
                "Certify one that symsimpson.compile or symsimpson.load made."
            )
        return tools.certify(self, q0, v0, p0=p0, h=h, parameters=parameters, inputs=inputs)
