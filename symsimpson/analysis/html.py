"""Certificates in HTML."""

from __future__ import annotations

from typing import Any

from symsimpson.results.html import verdict as coloured
from symsimpson.support.markup import box, table

__all__ = ["certificate"]


def certificate(result: Any) -> str:
    """Show what was measured, row by row."""
    rows: list[tuple[object, ...]] = [("", "check", "measured", "wanted", "what", "why")]
    for check in result.checks:
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
    numbers = (", ".join(f"{x:.6g}" for x in state) for state in (result.q0, result.p0))
    verdict = "passed" if result.passed else "NOT passed"
    where = "at q0 = ({}), p0 = ({}), h = {:g}; {:.1f} s".format(*numbers, result.h, result.seconds)
    title = f"Certificate of {result.system}, {result.scheme} (order {result.order}): {verdict}"
    return box(title, f"<div>{where}</div>", table(rows))
