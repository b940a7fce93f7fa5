"""Problems in the language of the packages that are compared with."""

from __future__ import annotations

import math
from typing import Any

__all__ = ["double_pendulum"]


def double_pendulum(hy: Any) -> Any:
    """Give heyoka's equations of motion of the catalogue's double pendulum."""
    q1, q2, v1, v2 = hy.make_vars("q1", "q2", "v1", "v2")
    g = 9.81
    l = g / (2 * math.pi) ** 2
    lagrangian = (
        l**2 * (v1**2 + v2**2 / 2.0 + v1 * v2 * hy.cos(q1 - q2))
        + g * l * (2.0 * hy.cos(q1) + hy.cos(q2))
    )  # fmt: skip
    return hy.lagrangian(lagrangian, [q1, q2], [v1, v2])
