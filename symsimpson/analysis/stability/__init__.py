"""Stability: long runs, large steps, poles, chaos and large angles."""

from symsimpson.analysis.stability.chaotic_motion import Mixing, Reversal, mixing, reversal
from symsimpson.analysis.stability.drift import Drift, energy_drift
from symsimpson.analysis.stability.large_angles import Turned, turned
from symsimpson.analysis.stability.limits import energy_map, linear_limits, theory_limits
from symsimpson.analysis.stability.poles import PolePass, pole_sweep
from symsimpson.analysis.stability.report import stress, stress_standard

__all__ = [
    "Drift",
    "Mixing",
    "PolePass",
    "Reversal",
    "Turned",
    "energy_drift",
    "energy_map",
    "linear_limits",
    "mixing",
    "pole_sweep",
    "reversal",
    "stress",
    "stress_standard",
    "theory_limits",
    "turned",
]
