"""How a run ended: of whole runs, and of those of which little is kept."""

from __future__ import annotations

from typing import Any

from symsimpson.program.status import Status

__all__ = ["Outcome"]


class Outcome:
    """How a run ended."""

    status: Status
    message: str
    steps: int
    h: Any

    @property
    def success(self) -> bool:
        """Whether the run reached its end."""
        return self.status is Status.SUCCESS

    def _outcome(self) -> dict[str, Any]:
        """Return it for files."""
        return {
            "h": float(self.h),
            "steps": self.steps,
            "status": self.status.name,
            "message": self.message,
        }
