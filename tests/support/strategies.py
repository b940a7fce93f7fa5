"""Hypothesis strategies: systems, states, and input of every kind."""

import numpy as np
from hypothesis import strategies as st

from support.random_systems import drawn_system

__all__ = ["anything", "names", "runs", "states", "systems"]


@st.composite
def systems(draw):
    """Systems with 1 to 4 coordinates, M(q) positive definite, V of many kinds of terms."""
    pick = draw(st.randoms(use_true_random=False))
    return drawn_system(pick, "drawn", gyroscopic=draw(st.booleans()))


def states(n):
    """Positions and momenta: moderate, large, tiny, and what is no number."""
    usual = st.floats(-3, 3)
    odd = st.sampled_from([0.0, -0.0, 1e-308, 5e-324, 1e8, -1e12, 1e300, np.nan, np.inf, -np.inf])
    number = st.one_of(usual, usual, usual, odd)
    return st.lists(number, min_size=n, max_size=n)


#: What a user may pass by mistake.
anything = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(-(2**70), 2**70),
    st.floats(),
    st.text(max_size=5),
    st.binary(max_size=3),
    st.lists(st.floats(), max_size=4),
    st.complex_numbers(),
    st.dictionaries(st.text(max_size=2), st.floats(), max_size=2),
    st.lists(st.lists(st.integers(), max_size=2), max_size=2),
)


@st.composite
def runs(draw, n):
    """Arguments of integrate, right and wrong; few steps."""
    given = {
        "q0": draw(states(n)),
        "p0": draw(states(n)),
        "h": draw(st.one_of(st.floats(-0.5, 0.5), st.sampled_from([0.01, 1e-300, 1e300]))),
        "steps": draw(st.integers(0, 40)),
        "every": draw(st.sampled_from([1, 2, 7, 100, None])),
    }
    for name in draw(
        st.lists(st.sampled_from([*given, "t0", "t_end", "v0", "parameters"]), max_size=2)
    ):
        given[name] = draw(anything)
    if type(given["steps"]) is int and given["steps"] > 40:
        given["steps"] = 10**30  # more than can be counted, not more than anybody waits for
    return given


#: Names of symbols: what Unicode has, and what looks like code.
names = st.one_of(
    st.text(min_size=1, max_size=12),
    st.from_regex(r"[A-Za-z_][A-Za-z0-9_]{0,8}", fullmatch=True),
    st.sampled_from(
        ["W", "h", "lane", "__import__", "x y", "\u03b1", "lambda", "W[0]", "x'", '"""']
    ),
)
