"""The main frequencies of a quasi-periodic run, by Laskar's method.

The signal is projected on exp(i w t) with a window that vanishes smoothly at both ends. The largest
projection is a frequency; the signal without it has the next one (J. Laskar, Physica D 67 (1993),
257-281).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from symsimpson.errors import reject
from symsimpson.program.input_values import read_count
from symsimpson.support.array_types import Floats

Complexes = NDArray[np.complex128]

#: The power of the window cos^2: higher powers separate frequencies better in long runs.
POWER = 5
#: The fewest states, and the number of times that all terms are solved for together.
FEWEST, SWEEPS = 64, 12
#: The tolerance of a frequency, in units of 1 / duration.
TOLERANCE = 1e-15


def frequencies_of(run: Any, count: Any, of: Any) -> tuple[Floats, Complexes]:
    """Return the main frequencies of a run; see :meth:`Trajectory.frequencies`."""
    count = read_count("count", count, least=1)
    of = run.program.coordinates[0] if of is None else of
    signal = np.asarray(run[of] if isinstance(of, str) else of)
    if signal.shape != np.shape(run.t) or not np.isfinite(signal).all():
        reject(
            f"the signal has shape {signal.shape}, or a value that is not finite.",
            where=run.program.system,
            remedy=f"Pass {len(run)} finite numbers, one for each stored state.",
        )
    t = np.asarray(run.t, dtype=np.float64)
    if np.iscomplexobj(signal):
        return main_frequencies(t, signal, count)
    frequencies, amplitudes = main_frequencies(t, signal - signal.mean(), 2 * count)
    positive = frequencies > 0
    return frequencies[positive][:count], amplitudes[positive][:count]


def main_frequencies(t: Floats, signal: NDArray[Any], count: int) -> tuple[Floats, Complexes]:
    """Return angular frequencies and complex amplitudes, the largest first."""
    if len(t) < FEWEST:
        reject(
            f"the run has {len(t)} states, too few for frequencies.",
            remedy=f"Store at least {FEWEST} states: every=1.",
        )
    steps = np.diff(t)
    if abs(steps - steps.mean()).max() > 1e-9 * abs(steps.mean()):
        reject("the times of the states are not evenly spaced.", remedy="Pass t_eval=, or every=.")
    middle, half = (t[0] + t[-1]) / 2, (t[-1] - t[0]) / 2
    place = (t - middle) / half
    window = np.cos(np.pi * place / 2) ** (2 * POWER)
    window /= window.sum()
    signal = signal.astype(np.complex128)
    frequencies, left = np.zeros(0), signal
    for _ in range(count):
        spectrum = abs(np.fft.fft(window * left, 4 * len(t)))
        bins = np.fft.fftfreq(4 * len(t), place[1] - place[0]) * 2 * np.pi
        largest = _refined(place, window, left, float(bins[spectrum.argmax()]))
        frequencies = np.append(frequencies, largest)
        for _ in range(SWEEPS if len(frequencies) > 1 else 1):
            before = frequencies.copy()
            for k, w in enumerate(frequencies):  # each on the signal without the others
                waves, amplitudes = _fit(place, window, signal, frequencies)
                without = signal - np.delete(waves, k, 1) @ np.delete(amplitudes, k)
                frequencies[k] = _refined(place, window, without, w)
            if abs(frequencies - before).max() < 1e-13 * abs(frequencies).max():
                break
        waves, amplitudes = _fit(place, window, signal, frequencies)
        left = signal - waves @ amplitudes
    order = np.argsort(-abs(amplitudes))
    phases = np.exp(-1j * frequencies[order] * middle / half)
    return frequencies[order] / half, amplitudes[order] * phases


def _refined(place: Floats, window: Floats, signal: Complexes, start: float) -> float:
    """Return the maximum of abs(projection)^2 near a frequency, by Newton's method.

    Times are in units of half of the duration, and frequencies in units of 1 / half.
    """
    w = start
    for _ in range(30):
        turned = window * signal * np.exp(-1j * w * place)
        a, b, c = turned.sum(), (-1j * place * turned).sum(), (-(place**2) * turned).sum()
        slope = 2 * (a.conjugate() * b).real
        curved = 2 * (abs(b) ** 2 + (a.conjugate() * c).real)
        if not curved < 0:
            break
        change = -slope / curved
        w += float(np.clip(change, -1.0, 1.0))
        if abs(change) < TOLERANCE * max(1.0, abs(w)):
            break
    return w


def _fit(
    place: Floats, window: Floats, signal: Complexes, frequencies: Floats
) -> tuple[Complexes, Complexes]:
    """Return the waves, and their amplitudes that fit the signal best with the window as weight."""
    waves = np.exp(1j * np.outer(place, frequencies))
    weighted = waves.conjugate().T * window
    return waves, np.linalg.solve(weighted @ waves, weighted @ signal)
