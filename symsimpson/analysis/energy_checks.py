"""Energies in compiled runs: the one that a scheme keeps, drift, and the work of forces."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from symsimpson.analysis.certificate import Check
from symsimpson.analysis.subject import Subject
from symsimpson.api.stepper import Stepper

__all__ = ["LONG", "drift", "shadow", "shadow_is_testable"]

LONG = 100_000
#: Up to this order the energy swings by much more than the shadow energy that a scheme keeps.
HIGHEST_ORDER = 4
#: Steps of the run whose shadow energy is looked at, and the number that h is divided by there.
FEW, FINER = 100, 4
#: Rounding error of the shadow energy, relative to the energy.
SHADOW_ROUNDING = 1e-12


def shadow_is_testable(stepper: Stepper) -> bool:
    """Return whether runs can have a shadow energy that swings much less than the energy."""
    header = stepper.program.header
    family = "equations" in header.functions and not header.constraints
    differentiable = stepper.program.differentiate is not None
    return family and header.conservative and differentiable and header.order <= HIGHEST_ORDER


def shadow(s: Subject) -> Iterator[Check]:
    """shadow: check that the modified energy varies by less than half of what H does.

    Over few steps of h/4, from peak to peak; or less than half of its largest distance from H,
    where that is more.
    """
    if not shadow_is_testable(s.stepper):
        return
    run = s.compiled(FEW, every=1, parts=FINER)
    scale = float(run.energy_scale)
    kept = run.shadow_energy
    # H of the linear oscillator is constant with midpoint, and so is its distance from the other
    swing = max(np.ptp(run.energy), np.abs(kept - run.energy).max()) / scale
    yield Check.at_most(
        "shadow",
        float(np.ptp(kept)) / scale,
        0.5 * float(swing) + SHADOW_ROUNDING,
        f"swing of the energy that the scheme keeps, in {FEW} steps of h/{FINER}; H: {swing:.1e}",
        "H less the error of the action swings less than H; a drift would show at once.",
    )


def drift(s: Subject) -> Iterator[Check]:
    """drift: check that energy and momenta have no trend over many steps.

    What fails with h is measured again with h/2, up to h/16. Trends of a user's invariants, and of
    the energy of what rolls, are measured and not judged. Of systems that are not conservative the
    balance of energy and work is checked.
    """
    if not s.stepper.program.header.conservative:
        yield from _balance(s)
        return
    for parts in (1, 2, 4, 8, 16):  # coarse steps of chaotic motions jump between levels of H
        rows = list(_trends(s, parts))
        if all(row.passed for row in rows):
            break
    yield from rows


def _trends(s: Subject, parts: int) -> Iterator[Check]:
    """Measure trends over many steps with a part of h."""
    run = s.compiled(LONG, every=20, parts=parts)
    energy = {"energy": run.energy}
    momenta = {x.name: x.momentum(run.q, run.p) for x in s.symmetries}
    # what rolls makes no symplectic map, and its energy may wander
    kept, watched = (momenta, energy) if s.rolling else (energy | momenta, {})
    # rounding grows with the terms of a momentum: those of a free centre of mass grow with its path
    sizes = {x.name: x.size(run.q, run.p) for x in s.symmetries}
    if s.timed is not None:  # K is zero, but for errors
        sizes["energy"] = float(run.energy_scale)
    steps = f"{LONG} steps" + (f" of h/{parts}" if parts > 1 else "")
    for k, (name, values) in enumerate((kept | watched | run.invariants).items()):
        size = sizes.get(name, float(np.abs(values).max())) or 1.0
        blocks = (values[1:] / size).reshape(20, -1)
        trend = abs(float(np.polyfit(np.arange(20), blocks.mean(axis=1), 1)[0])) * 20
        swing = float(np.ptp(blocks))
        what = f"{name}: trend over {steps}; it swings by {swing:.1e}"
        if k < len(kept):
            yield Check.at_most(
                "drift",
                trend,
                max(1e-12, 0.2 * swing),
                what,
                "A symplectic map has no trend; a fifth of the swing is what chance may show.",
            )
        else:
            yield Check.at_most("watched", trend, float("inf"), what, "Nothing is promised.")


def _balance(s: Subject) -> Iterator[Check]:
    """balance: measure the order of energy less work from runs with h, h/2 and finer ones."""
    if "work" not in s.stepper.program.header.functions:
        return
    largest: list[float] = []
    for parts in (1, 2, 4, 8):  # until steps are fine enough to show the order
        run = s.compiled(200 * parts, every=1, parts=parts)
        largest.append(float(np.abs(run.energy_balance).max() / run.energy_scale))
        if parts == 1:
            continue
        lost = largest[-1] < 1e-12
        order = float(s.stepper.order) if lost else math.log2(largest[-2] / largest[-1])
        if order >= s.stepper.order - 1.0:
            break
    coarse, fine = ("h" if n == 1 else f"h/{n}" for n in (parts // 2, parts))
    yield Check.at_least(
        "balance",
        order,
        s.stepper.order - 1.0,
        f"energy less work: {largest[-2]:.1e} and {largest[-1]:.1e} of the energy "
        f"with {coarse} and {fine}",
        "What the energy differs by from the work done has the order of the scheme.",
    )
