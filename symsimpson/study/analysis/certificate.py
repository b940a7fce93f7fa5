"""Certificates: measurements on a stepper, row by row, with a verdict."""

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
    """One row of a certificate.

    Attributes
    ----------
    name : str
    measured : float
        NaN where there is nothing to measure, or it could not be measured.
    bound : {"at least", "at most"}
    threshold : float
    what : str
        What was measured.
    reason : str
        Why the threshold is what it is.
    failure : str
        Why it could not be measured.
    exempt : bool
        Whether there is nothing to measure.
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
        """Return a row that passes up to a threshold."""
        return cls(name, measured, "at most", threshold, what, reason)

    @classmethod
    def at_least(
        cls, name: str, measured: float, threshold: float, what: str, reason: str
    ) -> Check:
        """Return a row that passes from a threshold on."""
        return cls(name, measured, "at least", threshold, what, reason)

    @classmethod
    def not_asked(cls, name: str, what: str, reason: str, failure: str = "") -> Check:
        """Return a row that has nothing to measure; with a failure one that could not be."""
        nan = float("nan")
        return cls(name, nan, "at most", 0.0, what, reason, failure, exempt=not failure)

    @property
    def limit(self) -> str:
        """The bound and the threshold in short; empty where nothing was asked."""
        sign = ">=" if self.bound == "at least" else "<="
        digits = 2 if self.passed else 3  # what fails is seen to
        return "" if self.exempt else f"{sign} {self.threshold:.{digits}g}"

    @property
    def passed(self) -> bool:
        """The verdict; what could not be measured has not passed."""
        if self.exempt:
            return True
        if self.bound == "at least":
            return self.measured >= self.threshold
        return self.measured <= self.threshold


@dataclass(frozen=True)
class Certificate:
    """The measured properties of a stepper, with the state and the step used.

    Attributes
    ----------
    system, scheme : str
    order : int
        The scheme's.
    module : str
        SHA-256 of the generated module.
    q0, p0 : tuple of float
    h : float
    parameters : mapping from str to float
    checks : tuple of Check
        The rows; ``certificate["order"]`` is one of them. Each has its ``name``, what was
        ``measured`` and ``what`` that is, the ``threshold`` and a ``reason`` for it, and whether
        it ``passed``.
    seconds : float
        How long measuring took.
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
        """Whether every check passed."""
        return all(check.passed for check in self.checks)

    def __getitem__(self, name: str) -> Check:
        """Return a check by its name.

        Raises
        ------
        UnknownNameError
            If no check has this name.
        """
        known = {check.name: check for check in self.checks}
        if name not in known:
            reject(
                f"there is no check {name!r}.{did_you_mean(name, known)} "
                f"There are {', '.join(known)}.",
                error=UnknownNameError,
            )
        return known[name]

    def to_json(self) -> str:
        """Return it as text in JSON, the same every time but for the seconds."""
        content: dict[str, Any] = asdict(self) | {"parameters": dict(self.parameters)}
        for check, row in zip(self.checks, content["checks"], strict=True):
            row["measured"] = None if check.measured != check.measured else check.measured
            row["passed"] = check.passed
        return json.dumps(content | {"passed": self.passed}, indent=2) + "\n"

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write it to a file, in JSON.

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
        numbers = (", ".join(f"{x:.6g}" for x in state) for state in (self.q0, self.p0))
        verdict = "passed" if self.passed else "NOT passed"
        where = "at q0 = ({}), p0 = ({}), h = {:g}; {:.1f} s".format(*numbers, self.h, self.seconds)
        title = f"Certificate of {self.system}, {self.scheme} (order {self.order}): {verdict}"
        return box(title, f"<div>{where}</div>", table(rows))

    def __repr__(self) -> str:
        numbers = ("(" + ", ".join(f"{x:.6g}" for x in state) + ")" for state in (self.q0, self.p0))
        q0, p0 = numbers
        verdict = "passed" if self.passed else "NOT passed"
        lines = [
            f"{self.system}, {self.scheme} (order {self.order}): {verdict}",
            f"  from q0 = {q0}, p0 = {p0}, h = {self.h:g}; {self.seconds:.1f} s",
        ]
        for check in self.checks:
            measured = "-" if check.measured != check.measured else f"{check.measured:.3g}"
            mark = "ok  " if check.passed else "FAIL"
            told = check.failure or check.what
            lines.append(f"  {mark} {check.name:<12} {measured:>9} {check.limit:<10} {told}")
            if not check.passed:
                lines.append(f"       {check.reason}")
        return "\n".join(lines)
