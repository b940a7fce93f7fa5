"""Steps that are too large: for the linear oscillator against theory, for others as a map."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from symsimpson.api.compiling import compile as compile_system
from symsimpson.api.stepper import Stepper
from symsimpson.schemes.named import read_scheme
from symsimpson.schemes.scheme import Scheme
from symsimpson.support.array_types import Floats
from symsimpson.support.calling import without_step_warnings
from symsimpson.systems import harmonic_oscillator

__all__ = ["energy_map", "linear_limits", "theory_limits"]

STEPS = 4000
#: A trajectory from (1, 0) that comes further than this is unstable.
FAR = 1e6


@without_step_warnings()
def linear_limits(scheme: str | Scheme, largest: float = 6.0, width: float = 1e-4) -> list[float]:
    """Find where the linear oscillator turns unstable or stable again, as h omega grows.

    Runs of the compiled stepper decide, those of an ensemble with h = 1; each edge is bisected to
    ``width``.

    Parameters
    ----------
    scheme : str or Scheme
    largest : float
        Largest h omega looked at.
    width : float

    Returns
    -------
    list of float
        Edges, the first from stable to unstable.
    """
    q = harmonic_oscillator().coordinates[0]
    stepper = compile_system(harmonic_oscillator(), scheme)

    def stable(x: Floats) -> NDArray[np.bool_]:
        ensemble = stepper.ensemble(
            np.ones((x.size, 1)),
            p0=np.zeros((x.size, 1)),
            h=1.0,
            steps=STEPS,
            every=None,
            parameters={"m": 1.0, "k": x**2},
            reduce={"least": ("min", q), "largest": ("max", q)},
        )
        near = [np.abs(ensemble.reduced[name]) < FAR for name in ("least", "largest")]
        return (ensemble.status == 0) & near[0] & near[1]

    return _edges(stable, largest, width)


def _edges(
    stable: Callable[[Floats], NDArray[np.bool_]], largest: float, width: float
) -> list[float]:
    """Find where a property changes, by a scan and bisection."""
    grid = np.linspace(0.01, largest, round(largest / 0.01))
    seen = stable(grid)
    edges = np.flatnonzero(seen[:-1] != seen[1:])
    low, high, before = grid[edges], grid[edges + 1], seen[edges]
    while edges.size and (high - low).max() > width:
        middle = (low + high) / 2
        here = stable(middle) == before
        low, high = np.where(here, middle, low), np.where(here, high, middle)
    return [float(x) for x in (low + high) / 2]


def theory_limits(scheme: str | Scheme, largest: float = 6.0) -> list[float]:
    """Return the same edges from the scheme's tables: where |trace R| passes 2.

    The step (q0, p0) -> (q1, p1) of L = v^2/2 - q^2/2 is linear; for Simpson's scheme the edges are
    2 sqrt(2), 2 sqrt(3) and 2 sqrt(6).
    """
    method = read_scheme(scheme)

    def stable_at(x: float) -> bool:
        try:
            return bool(abs(np.trace(method.oscillator(x))) - 2 <= 1e-12)
        except np.linalg.LinAlgError:  # a pole of the map
            return False

    def stable(x: Floats) -> NDArray[np.bool_]:
        return np.array([stable_at(value) for value in x.tolist()])

    return _edges(stable, largest, 1e-12)


def energy_map(
    stepper: Stepper,
    steps: ArrayLike,
    parameter: str,
    values: ArrayLike,
    *,
    state: Mapping[str, Any],
    t_end: float,
) -> Floats:
    """Map the largest relative energy error over step sizes and a parameter.

    Parameters
    ----------
    stepper : Stepper
    steps : array_like, shape (a,)
        Step sizes; each is fitted to divide ``t_end``.
    parameter : str
    values : array_like, shape (b,)
    state : mapping
        q0, and v0 or p0.
    t_end : float

    Returns
    -------
    ndarray, shape (a, b)
        The range of the energy in units of its mean; infinite where a run failed.
    """
    column = np.asarray(values, dtype=np.float64)
    q0 = np.tile(np.asarray(state["q0"], dtype=np.float64), (column.size, 1))
    other = {key: value for key, value in state.items() if key != "q0"}
    rows = []
    for h in np.asarray(steps, dtype=np.float64):
        count = max(1, round(t_end / h))
        with without_step_warnings():
            ensemble = stepper.ensemble(
                q0,
                **other,
                h=t_end / count,
                steps=count,
                parameters={parameter: column},
                reduce={kind: (kind, "energy") for kind in ("min", "max", "mean")},
            )
        seen = ensemble.reduced
        good = (ensemble.status == 0) & np.isfinite(seen["mean"])
        row = np.full(column.size, np.inf)
        size = np.maximum(np.abs(seen["mean"][good]), 1e-300)
        row[good] = (seen["max"][good] - seen["min"][good]) / size
        rows.append(row)
    return np.array(rows)
