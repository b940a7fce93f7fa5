"""Stability: long runs, large steps, poles, chaos and large angles."""

from symsimpson.study.analysis.stability.standard_problems import (
    PolePass,
    energy_map,
    linear_limits,
    pole_sweep,
    theory_limits,
)
from symsimpson.study.analysis.stability.stress_tests import (
    Drift,
    Mixing,
    Reversal,
    Turned,
    energy_drift,
    mixing,
    reversal,
    stress,
    stress_standard,
    turned,
)

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
