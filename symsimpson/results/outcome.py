"""Parts of all results beside states: how a run ended, the derivatives that it carried along."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, NoReturn

from numpy.typing import NDArray

from symsimpson.errors import InputError
from symsimpson.program.program import Program
from symsimpson.program.status import Status


@dataclass(frozen=True, eq=False, repr=False, init=False, kw_only=True)
class Outcome:
    """How a run ended, and what was observed during the run."""

    h: Any
    steps: int
    status: Status
    message: str
    reduced_values: tuple[tuple[str, float], ...] = field(default=(), repr=False)
    #: Records of events that acted, in the order of time, and the names of all events.
    records: tuple[Any, ...] = field(default=(), repr=False)
    event_names: tuple[str, ...] = ()
    #: The largest error along the path, if :func:`symsimpson.integrate` measured it.
    error_estimate: float | None = None

    @property
    def success(self) -> bool:
        """Whether the run reached its end."""
        return self.status is Status.SUCCESS

    @property
    def reduced(self) -> dict[str, float]:
        """The quantities requested by ``reduce``; NaN where states after the end were taken in."""
        return dict(self.reduced_values)

    def _outcome(self) -> dict[str, Any]:
        """Return it for files."""
        estimate = {} if self.error_estimate is None else {"error_estimate": self.error_estimate}
        return {
            "h": float(self.h),
            "steps": self.steps,
            "status": self.status.name,
            "message": self.message,
            **estimate,
        }


def iterations_a_step(run: Any) -> float | None:
    """Return Newton iterations a step, up to the last stored state; None if it is the first."""
    steps = run.steps if run.every is None else min((len(run) - 1) * run.every, run.steps)
    return float(run.newton_iterations.sum()) / steps if steps else None


class Differentiated:
    """Derivatives that were carried along beside states; ensembles have an axis of members."""

    program: Program
    variations: NDArray[Any] | None

    @property
    def _names_varied(self) -> tuple[str, ...]:
        """Parameters and inputs that it was differentiated by."""
        return self.program.names.varied(self.program.header.varied_by or ())

    @property
    def tangent(self) -> NDArray[Any]:
        """Variations (dq, dp) of N stored states of n coordinates, shape (N, 2 n, k) for k of them.

        Raises
        ------
        InputError
            If the run carried none along.

        Examples
        --------
        >>> import symsimpson as ss
        >>> stepper = ss.compile(ss.systems.pendulum())
        >>> stepper.integrate([1.0], v0=[0.0], h=0.1, steps=50, tangents=2).tangent.shape
        (51, 2, 2)
        >>> stepper.ensemble([[1.0], [2.0]], v0=[0.0], h=0.1, steps=50, tangents=2).tangent.shape
        (2, 2, 2)
        """
        variations = self._carried("tangents=4")
        count = variations.shape[-1] - len(self._names_varied)
        return variations[..., :count] if count else self._missing("tangents=4")

    @property
    def sensitivity(self) -> dict[str, NDArray[Any]]:
        """Derivatives of N stored states (q, p), by name of parameter or input, shape (N, 2 n).

        Raises
        ------
        InputError
            If the run carried none along.

        Examples
        --------
        >>> import symsimpson as ss
        >>> stepper = ss.compile(ss.systems.pendulum())
        >>> run = stepper.integrate([1.0], v0=[0.0], h=0.1, steps=50, sensitivities="l")
        >>> run.sensitivity["l"].shape
        (51, 2)
        """
        variations, names = self._carried("sensitivities='l'"), self._names_varied
        first = variations.shape[-1] - len(names)
        return {name: variations[..., first + j] for j, name in enumerate(names)}

    def _carried(self, ask: str) -> NDArray[Any]:
        """Return all variations; those by parameters stand behind those of the state."""
        return self._missing(ask) if self.variations is None else self.variations

    def _missing(self, ask: str) -> NoReturn:
        raise InputError(
            "this run carried no derivatives of this kind along.\n"
            f"Ask for them: integrate(..., {ask})."
        )
