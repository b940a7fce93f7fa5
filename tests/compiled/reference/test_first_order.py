"""Equations of motion written down by themselves, Runge-Kutta, and a truth with its error."""

import mpmath as mp
import numpy as np
import pytest
from support.cases import sweep

import symsimpson as ss
from symsimpson.reference import ExactTop, canonical, reduced_top, rk4, second_order, truth
from symsimpson.reference.extrapolation import extrapolate
from symsimpson.study.analysis.order import observed_orders

LENGTH = "0.24849020288283338446611438352185703441293989488368"
PENDULUM = {"l1": LENGTH, "l2": LENGTH, "g": "9.81"}


@pytest.mark.slow
@pytest.mark.parametrize("name", sweep(ss.systems.CATALOGUE))
def test_both_forms_are_the_motion_of_the_integrator(name):
    """Simpson from q and v or p, against both forms."""
    system = ss.systems.CATALOGUE[name]()
    if system.n > 3:
        pytest.skip("long expressions")
    run = ss.compile(system).integrate(**system.reference_state, h=0.001, steps=100)
    _, y = rk4(canonical(system), [*run.q[0], *run.p[0]], h=1e-4, steps=1000)
    end = np.array([*run.q[-1], *run.p[-1]])
    assert np.abs(y[-1] - end).max() < 1e-7 * max(1, np.abs(end).max())
    v0 = system.reference_state.get("v0")
    if v0 is not None:
        _, y = rk4(second_order(system), [*run.q[0], *v0], h=1e-4, steps=1000)
        assert np.abs(y[-1, : system.n] - run.q[-1]).max() < 1e-7 * max(1, np.abs(end).max())


@pytest.mark.slow
def test_rk4_has_order_four():
    system = ss.systems.double_pendulum()
    ends = [
        rk4(canonical(system), [0.7, 1.0, 0, 0], h=0.01 / 2**k, steps=100 * 2**k)[1][-1]
        for k in range(5)
    ]
    errors = [np.abs(end - ends[-1]).max() for end in ends[:3]]
    assert np.abs(observed_orders(errors) - 4).max() < 0.3


@pytest.mark.slow
def test_rk4_stores_what_is_asked_for():
    equations = canonical(ss.systems.pendulum())
    t, y = rk4(equations, [1.0, 0.0], h=0.01, steps=25, every=10, parameters={"l": 2.0})
    assert t.tolist() == pytest.approx([0, 0.1, 0.2])
    assert y.shape == (3, 2)
    _, default = rk4(equations, [1.0, 0.0], h=0.01, steps=25, every=10)
    assert (y[-1] != default[-1]).all()
    for wrong in ({"y0": [1.0]}, {"steps": -1}, {"every": 0}, {"parameters": {"mass": 1}}):
        given = {"y0": [1.0, 0.0], "h": 0.1, "steps": 2} | wrong
        with pytest.raises(ValueError, match=r"y0|steps|parameter"):
            rk4(equations, **given)


@pytest.mark.slow
def test_truth_of_the_double_pendulum():
    """Against 21 digits of an independent Taylor integrator with 240 bits."""
    start = [
        "0.78539816339744830961566084581987572104929234984378",
        "1.047197551196597746154214461093167628065723133125",
        0,
        0,
    ]
    found = truth(
        canonical(ss.systems.double_pendulum()), start, [10], digits=24, parameters=PENDULUM
    )
    known = (
        "-0.248608400375483644278",
        "-0.613578116238233122889",
        "-0.628776077055703596207",
        "-0.470978102906563815312",
    )
    with mp.workdps(30):
        errors = [abs(x - mp.mpf(y)) for x, y in zip(found.y[0], known, strict=True)]
    assert max(errors) < 1e-19
    assert 1e-24 < found.error < 1e-17


def test_truth_and_odefun_agree():
    equations = canonical(ss.systems.pendulum())
    found = truth(equations, [1, 0], ["0.25", "0.5"], digits=22)
    with mp.workdps(22):
        f, values = equations.function("mpmath"), equations.values(None)
        solution = mp.odefun(lambda t, y: f(*y, *values), 0, [1, 0])
        for t, y in zip(found.t, found.y, strict=True):
            assert max(abs(a - b) for a, b in zip(y, solution(t), strict=True)) < 1e-20


def test_truth_of_the_top_is_the_exact_motion():
    with mp.workdps(40):
        top = ExactTop(
            [0, mp.pi / 6, 0],
            [0, 0, 2 * mp.pi],
            {"m_top": 1, "g": 1, "l": 4 * mp.pi**2, "I": 1, "I3": 2},
            digits=30,
        )
        start = [0, mp.pi / 6, 0]
        equations = reduced_top(2 * mp.pi * mp.sqrt(3), 4 * mp.pi, A=4 * mp.pi**2)
    found = truth(equations, start, [1], digits=24)
    q, p = top.state(1)
    for value, known in zip(found.y[0], (q[0], q[1], p[1]), strict=True):
        assert abs(value - known) < 1e-20


@pytest.mark.slow
def test_truth_gives_up_at_a_singularity():
    """A planet without angular momentum falls into its sun."""
    with pytest.raises(ArithmeticError, match="small enough at t = 1"):
        truth(canonical(ss.systems.kepler()), [1, 0, 0, 0], [2], digits=15)


def test_extrapolation_goes_back_in_time():
    with mp.workdps(40):
        times = [mp.mpf(-1), mp.mpf(-3)]
        found = extrapolate(lambda y: [y[1], -y[0]], [mp.mpf(1), mp.mpf(0)], times, 1e-30)
        for t, (q, p) in zip(times, found, strict=True):
            assert max(abs(q - mp.cos(t)), abs(p + mp.sin(t))) < 1e-28


@pytest.mark.parametrize("end", [60, 1e5, -1e12, 1e300])
def test_extrapolation_tells_soon_that_steps_are_too_many(end):
    """A turn takes some six steps: ten turns are too many for 20, and 60 is enough for them."""
    taken, origin = [], [mp.mpf(1), mp.mpf(0)]

    def f(y):
        taken.append(y)
        return [y[1], -y[0]]

    with mp.workdps(40):
        with pytest.raises(ArithmeticError, match="more than 20 steps"):
            extrapolate(f, origin, [mp.mpf(end)], 1e-30, 20)
        assert len(taken) < 20 * 24 * 25
        extrapolate(f, origin, [mp.mpf(3)], 1e-30, 20)
