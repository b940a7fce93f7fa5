"""Gradients of forced runs against golden values of 34 digits: of w.(q, p) at the end."""

import mpmath as mp
import numpy as np
import pytest
import sympy as sp
from support.cases import sweep
from support.forced_cases import CASES, given_to, stepper_of

WITH_GRADIENT = [case for case in CASES if "gradient_of_w_dot_(q,p)" in case["results"]["final"]]


def gradient_of(case, number, **options):
    """Return the gradient by q0, p0 and what is named, and what it should be."""
    truth = case["results"]["final"]["gradient_of_w_dot_(q,p)"]
    n, stepper = len(case["q0"]), stepper_of(case, **options)
    names = [sp.Symbol(f"{x}q{i}") for x in ("", "p_") for i in range(n)]
    cost = sum(sp.Rational(w) * x for w, x in zip(case["cost_weights"], names, strict=True))
    start, given = given_to(case, number)
    found = stepper.gradient(start, **given, cost=cost, wrt=("q", "p", *truth["parameters"]))
    inputs = np.shape(given["inputs"])[:-1] if "inputs" in case else ()
    own = [found.parts["q"], found.parts["p"]]
    for name in truth["parameters"]:  # that of an input is of the same change at all steps
        assert found.parts[name].shape == (inputs if name == "u" else ())
        own.append(found.parts[name].sum())
    expected = [*truth["initial_state"], *truth["parameters"].values()]
    return np.hstack(own), np.frompyfunc(mp.mpf, 1, 1)(np.array(expected, dtype=object))


def relative(found, truth):
    return abs(found - truth).max() / abs(truth).max()


@pytest.mark.parametrize("case", sweep(WITH_GRADIENT, 0), ids=lambda case: case["name"])
def test_gradients_in_double_precision(case):
    found, truth = gradient_of(case, float)
    assert relative(found.astype(object), truth) < 1e-13


@pytest.mark.slow
@pytest.mark.parametrize("case", sweep(WITH_GRADIENT, 1), ids=lambda case: case["name"])
def test_gradients_in_many_digits(case):
    with mp.workdps(45):
        found, truth = gradient_of(case, mp.mpf, precision=45)
        assert relative(found, truth) < 1e-30
