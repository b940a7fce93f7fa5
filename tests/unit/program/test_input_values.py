"""Functions that users pass in place of values."""

import numpy as np
import pytest

import symsimpson as ss
from symsimpson.program.input_values import values_at

TIMES = np.arange(6.0).reshape(3, 2)


def in_one_row(t):
    """Accept a number or one row of times, as the dense output of solve_ivp does."""
    if np.ndim(t) > 1:
        raise ValueError("`x` must be at most 1-dimensional.")
    return np.vstack([np.square(t), t])[0] if np.ndim(t) else float(t) ** 2


def test_functions_get_times_in_one_row():
    calls = []
    values = values_at("u", lambda t: calls.append(np.shape(t)) or in_one_row(t), TIMES)
    assert np.array_equal(values, TIMES**2)
    assert calls == [(6,)]


def by_quadrature(t):
    """Integrate 2 t from 0; of many times it has another shape."""
    places = np.linspace(0, t, 9)
    return np.trapezoid(2 * places, places)


@pytest.mark.parametrize("single", [lambda t: t**2 if t > 0 else 0.0, by_quadrature])
def test_functions_of_single_numbers(single):
    assert values_at("u", single, TIMES) == pytest.approx(TIMES**2)


@pytest.mark.parametrize("wrong", [lambda t: t[:1], lambda t: np.array([t, t])[:, None]])
def test_shapes_are_told(wrong):
    with pytest.raises(ss.InputError, match=r"^u: its function returns shape"):
        values_at("u", wrong, TIMES)


def test_errors_of_functions_have_a_note():
    with pytest.raises(ZeroDivisionError) as caught:
        values_at("u", lambda t: 1 / 0, TIMES)
    assert caught.value.__notes__ == ["The function that is passed as u raised this at t=0.0."]
