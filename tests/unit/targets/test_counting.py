"""Operations counted by running a module are those that its text shows."""

import re

import pytest
import sympy as sp
from support.cases import sweep

import symsimpson as ss
from symsimpson.lower.pipeline import source
from symsimpson.targets.counting import Cost, cost


def kernel_of(text, name):
    body = text[text.index(f"def {name}(") :]
    return body[: body.index("\n\n\n")]


def bound():
    """A particle whose force has roots, exponentials and logarithms."""
    (x,) = ss.coordinates("x")
    potential = sp.exp(-2 * x) - 2 * sp.exp(-x) + sp.sqrt(1 + x**2) + x * sp.log(2 + x**2)
    kinetic = (2 + x**2) * x.diff() ** 2
    return ss.MechanicalSystem("bound", coordinates=(x,), kinetic=kinetic, potential=potential)


@pytest.mark.parametrize("make", sweep([ss.systems.kepler, bound, ss.systems.lagrange_top], 2))
@pytest.mark.parametrize("exploit", [(), "all"])
def test_straight_lines_are_counted_as_their_sections_say(make, exploit):
    """But for changes of sign, which only the sections count."""
    text = source(make(), "simpson", exploit)
    counted = cost(text)
    for kernel, total in (("newton", counted.iteration), ("advance", counted.closing)):
        body = kernel_of(text, kernel)
        solved = "step_equations(" in body  # by loops, which say nothing
        body += kernel_of(text, "step_equations") if solved else ""
        stated = sum(map(int, re.findall(r": (\d+) operations", body)))
        stated += sum(map(int, re.findall(r"(\d+) sincos", body)))
        if (
            solved
        ):  # elimination takes 2 n^3 / 3, both substitutions 2 n^2; corrections are measured
            n = counted.unknowns
            assert 0 < total - stated <= 2 * n**3 / 3 + 2 * n**2 + 8 * n
        else:
            assert total <= stated <= 1.07 * total


def test_products_with_a_zero_of_the_text_are_not_counted():
    text = source(ss.systems.n_pendulum(3), "midpoint")
    solve = "        solve_in_pairs(W, lane)\n"
    assert text.count(solve) == 1
    sparse = text.replace(solve, f"        W[JACOBIAN + 3, lane] = 0\n{solve}")
    assert cost(sparse).iteration < cost(text).iteration


def test_a_direct_step_has_no_iteration():
    found = cost(source(ss.systems.harmonic_oscillator()))
    assert found == Cost(unknowns=0, iteration=0, closing=found.closing)
    assert 20 < found.closing < 40


def test_loops_are_counted_each_time():
    short, long = (cost(source(ss.systems.fermi_pasta_ulam(n))) for n in (10, 20))
    assert 1.9 < long.iteration / short.iteration < 2.2
