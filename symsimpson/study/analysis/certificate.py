"""Certificates: measured properties of a stepper, each with a threshold."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

from symsimpson.errors import UnknownNameError, reject
from symsimpson.results.html import verdict as coloured
from symsimpson.support.files import write_text
from symsimpson.support.markup import box, table
from symsimpson.support.names import did_you_mean


@dataclass(frozen=True)
class Check:
    """One row of a certificate: a measured property and its threshold.

    Attributes
    ----------
    name : str
        The name of the property, for example "order".
    measured : float
        The measured value. It is NaN if the check is exempt or the measurement failed.
    bound : {"at least", "at most"}
        The sense of the threshold.
    threshold : float
        The limit of ``measured`` for the check to pass.
    what : str
        A description of the measured quantity.
    reason : str
        The reason for the threshold.
    failure : str, default ""
        The error that prevented the measurement; empty if there was none.
    exempt : bool, default False
        Whether the property does not apply to this stepper. The check then passes.

    Examples
    --------
    >>> from symsimpson.study.analysis.certificate import Check
    >>> check = Check.at_least("order", 3.98, 3.85, "errors", "The scheme has order 4.")
    >>> check.passed, check.limit
    (True, '>= 3.9')
    """

    name: str
    measured: float
    bound: Literal["at least", "at most"]
    threshold: float
    what: str
    reason: str
    failure: str = ""
    exempt: bool = False

    @classmethod
    def at_most(cls, name: str, measured: float, threshold: float, what: str, reason: str) -> Check:
        """Return a check that passes if the value is at most the threshold."""
        return cls(name, measured, "at most", threshold, what, reason)

    @classmethod
    def at_least(
        cls, name: str, measured: float, threshold: float, what: str, reason: str
    ) -> Check:
        """Return a check that passes if the value is at least the threshold."""
        return cls(name, measured, "at least", threshold, what, reason)

    @classmethod
    def without_value(cls, name: str, what: str, reason: str, failure: str = "") -> Check:
        """Return an exempt check, or, with a ``failure``, one whose measurement failed."""
        nan = float("nan")
        return cls(name, nan, "at most", 0.0, what, reason, failure, exempt=not failure)

    @property
    def limit(self) -> str:
        """The threshold with its sign, for example ">= 3.9"; empty for an exempt check."""
        sign = ">=" if self.bound == "at least" else "<="
        digits = 2 if self.passed else 3  # 7.83 must not be shown as failing ">= 7.8"
        return "" if self.exempt else f"{sign} {self.threshold:.{digits}g}"

    @property
    def passed(self) -> bool:
        """True if the check passed. A failed measurement does not pass."""
        if self.exempt:
            return True
        if self.bound == "at least":
            return self.measured >= self.threshold
        return self.measured <= self.threshold


@dataclass(frozen=True)
class Certificate:
    """The measured properties of a stepper, with the state and the step size of the measurement.

    :meth:`Stepper.certify` returns it. ``certificate["order"]`` is the check with this name.

    Attributes
    ----------
    system, scheme : str
        The names of the system and of the scheme.
    order : int
        The nominal order of the scheme.
    module : str
        The SHA-256 digest of the generated module.
    q0, p0 : tuple of float, length n
        The state at which the properties were measured.
    h : float
        The step size of the measurement.
    parameters : mapping from str to float
        The values of all parameters.
    checks : tuple of Check
        The checks. Each has a ``name``, the ``measured`` value, its description ``what``, a
        ``threshold`` with its ``reason``, and ``passed``.
    seconds : float
        The duration of the measurement, in s.

    Examples
    --------
    >>> import symsimpson as ss
    >>> certificate = ss.compile(ss.systems.pendulum(), "midpoint").certify([1.0], [0.0], h=0.1)
    >>> certificate.passed, round(certificate["order"].measured)
    (True, 2)
    """

    system: str
    scheme: str
    order: int
    module: str
    q0: tuple[float, ...]
    p0: tuple[float, ...]
    h: float
    parameters: Mapping[str, float]
    checks: tuple[Check, ...]
    seconds: float

    @property
    def passed(self) -> bool:
        """True if all checks passed."""
        return all(check.passed for check in self.checks)

    @property
    def _title(self) -> str:
        verdict = "passed" if self.passed else "NOT passed"
        return f"{self.system}, {self.scheme} (order {self.order}): {verdict}"

    def __getitem__(self, name: str) -> Check:
        """Return the check with this name.

        Raises
        ------
        UnknownNameError
            If no check has this name.
        """
        known = {check.name: check for check in self.checks}
        if name not in known:
            reject(
                f"the certificate has no check {name!r}.{did_you_mean(name, known)} "
                f"Its checks are {', '.join(known)}.",
                error=UnknownNameError,
            )
        return known[name]

    def to_json(self) -> str:
        """Return the certificate as JSON text. Only ``seconds`` differs between repetitions."""
        content: dict[str, Any] = asdict(self) | {"parameters": dict(self.parameters)}
        for check, row in zip(self.checks, content["checks"], strict=True):
            row["measured"] = None if check.measured != check.measured else check.measured
            row["passed"] = check.passed
        return json.dumps(content | {"passed": self.passed}, indent=2) + "\n"

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write the certificate to a JSON file, and return the path of the file.

        Parameters
        ----------
        path : str or path-like
            The file to write. An existing file is replaced.

        Raises
        ------
        StorageError
            If the file cannot be written.
        """
        return write_text(path, self.to_json(), "certificate")

    def _repr_html_(self) -> str:
        rows: list[tuple[object, ...]] = [("", "check", "measured", "wanted", "what", "why")]
        for check in self.checks:
            nothing = check.measured != check.measured
            rows.append(
                (
                    coloured("passed" if check.passed else "FAILED", check.passed),
                    check.name,
                    "-" if nothing else f"{check.measured:.3g}",
                    check.limit,
                    check.failure or check.what,
                    check.reason,
                )
            )
        q0, p0 = (", ".join(f"{x:.6g}" for x in state) for state in (self.q0, self.p0))
        where = f"at q0 = ({q0}), p0 = ({p0}), h = {self.h:g}; {self.seconds:.1f} s"
        return box(f"Certificate of {self._title}", f"<div>{where}</div>", table(rows))

    def __repr__(self) -> str:
        q0, p0 = (", ".join(f"{x:.6g}" for x in state) for state in (self.q0, self.p0))
        where = f"from q0 = ({q0}), p0 = ({p0}), h = {self.h:g}; {self.seconds:.1f} s"
        lines = [self._title, f"  {where}"]
        for check in self.checks:
            measured = "-" if check.measured != check.measured else f"{check.measured:.3g}"
            mark = "ok  " if check.passed else "FAIL"
            text = check.failure or check.what
            lines.append(f"  {mark} {check.name:<12} {measured:>9} {check.limit:<10} {text}")
            if not check.passed:
                lines.append(f"       {check.reason}")
        return "\n".join(lines)
