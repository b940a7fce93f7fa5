"""The rows of a programme, as they come."""

from __future__ import annotations

from typing import Any

import numpy as np

from symsimpson.support.array_types import Floats, Ints

__all__ = ["Rows"]


class Rows:
    """Rows as they come; the first is that of the cost."""

    def __init__(self) -> None:
        self.count = 1
        self.low: list[Floats] = []
        self.high: list[Floats] = []
        self.names: list[str] = []
        self.scales: list[Floats] = []
        self.at, self.columns, self.data = (
            np.zeros(0, dtype=k) for k in (np.int64, np.int64, float)
        )

    def add(self, count: int, low: float, high: float, name: str, scale: Any = 1.0) -> Ints:
        """Return the numbers of further rows between two bounds, and by what they are scaled."""
        self.scales.append(np.array(np.broadcast_to(scale, count)))
        self.low.append(np.full(count, low))
        self.high.append(np.full(count, high))
        self.names += [name] * count
        self.count += count
        return np.arange(self.count - count, self.count)

    def linear(self, at: Ints, columns: Ints, factor: float) -> None:
        """Add unknowns to rows."""
        self.at = np.concatenate([self.at, at.ravel()])
        self.columns = np.concatenate([self.columns, columns.ravel()])
        self.data = np.concatenate([self.data, np.full(at.size, factor)])
