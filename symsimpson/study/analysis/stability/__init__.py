"""Stability tests: long runs, large steps, poles, chaotic motion and large angles."""

from symsimpson.study.analysis.stability.run_comparisons import Mixing as Mixing
from symsimpson.study.analysis.stability.run_comparisons import Reversal as Reversal
from symsimpson.study.analysis.stability.run_comparisons import TurnComparison as TurnComparison
from symsimpson.study.analysis.stability.run_comparisons import compare_turns as compare_turns
from symsimpson.study.analysis.stability.run_comparisons import mixing as mixing
from symsimpson.study.analysis.stability.run_comparisons import reversal as reversal
from symsimpson.study.analysis.stability.standard_problems import PolePass as PolePass
from symsimpson.study.analysis.stability.standard_problems import energy_map as energy_map
from symsimpson.study.analysis.stability.standard_problems import linear_limits as linear_limits
from symsimpson.study.analysis.stability.standard_problems import pole_sweep as pole_sweep
from symsimpson.study.analysis.stability.standard_problems import theory_limits as theory_limits
from symsimpson.study.analysis.stability.stress_tests import Drift as Drift
from symsimpson.study.analysis.stability.stress_tests import energy_drift as energy_drift
from symsimpson.study.analysis.stability.stress_tests import stress as stress
from symsimpson.study.analysis.stability.stress_tests import stress_standard as stress_standard
