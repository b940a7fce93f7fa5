"""Ends of runs, of whole ones and of those of which little is kept."""

from __future__ import annotations

from typing import Any

from symsimpson.program.status import Status

__all__ = ["Outcome", "iterations_a_step"]


class Outcome:
    """How a run ended, and what was observed on its way."""

    status: Status
    message: str
    steps: int
    h: Any
    reduced_values: tuple[tuple[str, float], ...]
    #: The largest error along the path, if :func:`symsimpson.integrate` measured it.
    error_estimate: float | None

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
