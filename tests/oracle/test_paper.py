"""The tables and the claims of the paper on Simpson's scheme for nonlinear systems.

Error norms h, h/2, h/4, ...: three digits of each. Orders: those of the finer pairs to 0.05.
"""

import math
from functools import cache

import numpy as np
import pytest
from support.cases import sweep

import symsimpson as ss
from symsimpson.reference import ExactTop, canonical, reduced_top, rk4, second_order
from symsimpson.study.analysis.order import observed_orders

GRAVITY, TURN = 9.81, 2 * math.pi
TOY = {"m_top": 0.1, "g": GRAVITY, "l": 0.15, "I": 0.00233, "I3": 0.000125}
TOP = {"q0": [0, math.pi / 3, 0], "v0": [9.2, 0, 252]}


@cache
def stepper(name, scheme):
    return ss.compile(ss.systems.CATALOGUE[name](), scheme)


def pendulum_run(scheme, length, h, steps):
    """Give times, positions and relative energy error of the double pendulum."""
    parameters = {"m1": 1, "m2": 1, "l1": length, "l2": length, "g": GRAVITY}
    q0 = [math.pi / 4, math.pi / 3]
    if scheme == "rk4":
        equations = canonical(ss.systems.double_pendulum())
        t, y = rk4(equations, [*q0, 0, 0], h=h, steps=steps, parameters=parameters)
        H = stepper("double_pendulum", "simpson").energy(y[:, :2], y[:, 2:], parameters)
        return t, y[:, :2], H / H[0] - 1
    run = stepper("double_pendulum", scheme).integrate(
        q0, p0=[0, 0], h=h, steps=steps, parameters=parameters
    )
    return run.t, run.q, run.energy_error


def top_run(method, h, steps):
    """Give times, nutation, energy error and momenta of the top with loops."""
    simpson = stepper("lagrange_top", "simpson")
    if not method.startswith("rk4"):
        run = stepper("lagrange_top", method).integrate(**TOP, h=h, steps=steps, parameters=TOY)
        return run.t, run.q[:, 1], run.energy_error, run.p
    start = simpson.integrate(**TOP, h=h, steps=0, parameters=TOY)
    if method == "rk4 (q, v)":
        equations = second_order(ss.systems.lagrange_top())
        t, y = rk4(equations, [*TOP["q0"], *TOP["v0"]], h=h, steps=steps, parameters=TOY)
        return t, y[:, 1], None, None
    equations = canonical(ss.systems.lagrange_top())
    t, y = rk4(equations, [*start.q[0], *start.p[0]], h=h, steps=steps, parameters=TOY)
    H = simpson.energy(y[:, :3], y[:, 3:], TOY)
    return t, y[:, 1], H / H[0] - 1, y[:, 3:]


@cache
def exact_top():
    return ExactTop(**TOP, parameters=TOY, digits=20)


def nutation_error(method, h, periods):
    t, theta, *_ = top_run(method, h, math.floor(periods * float(exact_top().period) / h))
    exact = exact_top().nutation(t)
    return np.abs(theta / exact - 1).max()


def energy_error(method, h, periods):
    steps = math.floor(periods * float(exact_top().period) / h)
    return np.abs(top_run(method, h, steps)[2]).max()


def compare(found, printed):
    assert found == pytest.approx([float(x) for x in printed.split()], rel=2e-3)


PENDULUM_ENERGY = {
    (2, 10): {
        "simpson": "4.4115e-4 2.2239e-5 1.3304e-6 8.3515e-8 5.2068e-9 3.2555e-10",
        "midpoint": "3.2242e-3 1.1918e-3 3.5513e-4 8.9637e-5 2.2873e-5 5.7564e-6",
        "rk4": "5.6232e-2 3.0332e-3 1.0312e-4 3.2795e-6 1.0321e-7 3.2505e-9",
    },
    (2, 100): {
        "simpson": "5.0944e-4 2.4324e-5 1.4628e-6 9.0664e-8 5.6541e-9 3.5374e-10",
        "midpoint": "3.2278e-3 1.2176e-3 3.5752e-4 9.2507e-5 2.3434e-5 5.8870e-6",
        "rk4": "2.5800e-1 2.6362e-2 9.8170e-4 3.1281e-5 9.8205e-7 3.0761e-8",
    },
    (2, 1000): {
        "simpson": "5.0944e-4 2.4433e-5 1.4659e-6 9.0818e-8 5.6631e-9 3.5375e-10",
        "midpoint": "3.2332e-3 1.2178e-3 3.5781e-4 9.6493e-5 2.3438e-5 5.8872e-6",
        "rk4": "5.1726e-1 1.5893e-1 9.4712e-3 3.1359e-4 9.8517e-6 3.0815e-7",
    },
    (1, 10): {
        "simpson": "8.7281e-6 5.2983e-7 3.2888e-8 2.0579e-9",
        "midpoint": "8.2506e-4 2.2463e-4 5.7257e-5 1.4461e-5",
        "rk4": "4.0177e-4 1.3122e-5 4.1468e-7 1.3025e-8",
    },
    (1, 100): {
        "simpson": "9.3919e-6 5.7465e-7 3.5703e-8 2.2419e-9",
        "midpoint": "8.2899e-4 2.3321e-4 5.8117e-5 1.4914e-5",
        "rk4": "3.8676e-3 1.2819e-4 4.0491e-6 1.2695e-7",
    },
}


@pytest.mark.parametrize("scheme", ["simpson", "midpoint", "rk4"])
@pytest.mark.parametrize(("power", "end"), sweep(PENDULUM_ENERGY, 0))
def test_table_of_the_double_pendulum(power, end, scheme):
    """Energy error for l = g/omega^2 (as corrected) and l = g/omega (as printed)."""
    printed = PENDULUM_ENERGY[power, end][scheme]
    found = []
    for k in range(len(printed.split())):
        h = 0.1 / 2**k
        error = pendulum_run(scheme, GRAVITY / TURN**power, h, round(end / h))[2]
        found.append(np.abs(error).max())
    compare(found, printed)
    if scheme != "rk4":
        order = 4 if scheme == "simpson" else 2
        assert observed_orders(found)[-1] == pytest.approx(order, abs=0.05)


NUTATION = {
    1: {
        "simpson": "9.350e-4 5.567e-5 3.438e-6 2.142e-7 1.338e-8 8.363e-10",
        "midpoint": "2.886e-1 6.847e-2 1.691e-2 4.213e-3 1.052e-3 2.631e-4",
        "rk4": "7.045e-3 3.373e-4 1.688e-5 9.177e-7 5.285e-8 3.160e-9",
        "rk4 (q, v)": "9.937e-3 5.721e-4 3.420e-5 2.094e-6 1.296e-7 8.066e-9",
    },
    10: {
        "simpson": "5.749e-3 3.236e-4 1.961e-5 1.216e-6 7.582e-8",
        "midpoint": "7.160 1.137 2.295e-1 5.393e-2 1.327e-2",
        "rk4": "6.277e-1 1.867e-2 6.613e-4 2.549e-5 1.095e-6",
    },
    100: {
        "simpson": "5.932e-2 3.224e-3 1.948e-4 1.207e-5 7.528e-7",
        "midpoint": "21.03 21.04 6.065 7.212e-1 1.481e-1",
        "rk4": "20.79 3.969 5.857e-2 1.836e-3 6.046e-5",
        "rk4 (q, v)": "20.86 1.409 3.220e-2 1.116e-3 4.259e-5",
    },
    1000: {
        "simpson": "7.706e-1 3.278e-2 1.948e-3 1.207e-4 7.530e-6",
        "midpoint": "21.04 21.04 21.05 21.05 2.683",
        "rk4": "20.79 21.04 21.05 1.921e-1 5.551e-3",
    },
}


@pytest.mark.parametrize("periods", sweep(NUTATION, 0))
def test_table_of_nutation(periods):
    for method, printed in NUTATION[periods].items():
        steps = 0.05 / 2.0 ** np.arange(len(printed.split()))
        found = [nutation_error(method, h, periods) for h in steps]
        compare(found, printed)
        if method == "simpson":
            assert observed_orders(found)[2:] == pytest.approx(4, abs=0.05)


ENERGY = {
    "simpson": {
        1: "1.172e-7 7.461e-9 4.621e-10 2.881e-11",
        1000: "1.231e-7 7.461e-9 4.621e-10 2.882e-11",
    },
    "midpoint": {
        1: "1.843e-5 4.737e-6 1.193e-6 2.987e-7",
        1000: "1.843e-5 4.737e-6 1.193e-6 2.987e-7",
    },
    "rk4": {
        1: "5.449e-7 2.532e-8 1.260e-9 6.796e-11",
        10: "6.652e-6 2.249e-7 7.547e-9 2.648e-10",
        100: "6.371e-5 2.210e-6 7.041e-8 2.233e-9",
        1000: "5.424e-4 2.117e-5 6.981e-7 2.192e-8",
    },
}


@pytest.mark.slow
@pytest.mark.parametrize("method", sweep(ENERGY))
def test_table_of_energy(method):
    for periods, printed in ENERGY[method].items():
        compare([energy_error(method, 0.05 / 2**k, periods) for k in range(4)], printed)


CUSPS = {
    1: {
        "simpson - rk4": "5.029e-3 3.609e-4 2.097e-5 1.209e-6 7.230e-8 4.421e-9 2.733e-10",
        "simpson": "4.534e-3 3.173e-4 2.021e-5 1.276e-6 7.983e-8",
        "rk4": "9.564e-3 6.782e-4 4.118e-5 2.485e-6 1.520e-7",
    },
    10: {
        "simpson - rk4": "2.541e-1 1.390e-2 5.472e-4 2.305e-5 1.081e-6 5.624e-8 3.159e-9",
        "simpson": "4.237e-2 2.963e-3 1.911e-4 1.201e-5 7.516e-7",
    },
}


@pytest.mark.parametrize("end", sweep(CUSPS, 0))
def test_convergence_on_the_top_with_cusps(end):
    """Simpson on the complete system, RK4 on the reduced one, and the exact nutation."""
    system = ss.systems.lagrange_top_cusps()
    exact = ExactTop(**system.reference_state, parameters=system.parameters, digits=20)
    equations = reduced_top(TURN * math.sqrt(3), 2 * TURN)
    found = {name: [] for name in CUSPS[1]}
    for k in range(7):
        h = 0.1 / 2**k
        run = stepper("lagrange_top_cusps", "simpson").integrate(
            **system.reference_state, h=h, steps=round(end / h)
        )
        t, y = rk4(equations, [0, math.pi / 6, 0], h=h, steps=round(end / h))
        found["simpson - rk4"].append(np.abs(run.q[:, 1] - y[:, 1]).max())
        found["simpson"].append(np.abs(run.q[:, 1] - exact.nutation(t)).max())
        found["rk4"].append(np.abs(y[:, 1] - exact.nutation(t)).max())
    for name, printed in CUSPS[end].items():
        compare(found[name][: len(printed.split())], printed)
    if end == 1:
        assert observed_orders(found["simpson - rk4"])[-1] == pytest.approx(4, abs=0.05)


def test_claim_period_of_nutation():
    """1.84671 s belongs to I = 0.00233, not to the moment of inertia in the table's source."""
    assert f"{float(exact_top().period):.5f}" == "1.84671"
    other = ExactTop(**TOP, parameters=TOY | {"I": 0.002329969592394382})
    assert f"{float(other.period):.5f}" == "1.84724"


@pytest.mark.slow
def test_claim_no_artificial_dissipation():
    """Energy errors of the symplectic schemes stay where they are, that of RK4 grows with time."""
    for scheme in ("simpson", "midpoint"):
        error = np.abs(pendulum_run(scheme, GRAVITY / TURN**2, 0.1, 10_000)[2][1:])
        first, last = np.split(error, 2)
        assert 0.9 < last.max() / first.max() < 1.1
        mean = [block.mean() for block in np.split(error, 10)]
        assert np.ptp(mean) < 0.2 * np.mean(mean)
    error = pendulum_run("rk4", GRAVITY / TURN**2, 0.1, 10_000)[2]
    assert np.abs(error[-1]) > 5 * np.abs(error[100])


@pytest.mark.slow
def test_claim_momenta_are_preserved_exactly():
    steps = math.floor(100 * float(exact_top().period) / 0.05)
    for method in ("simpson", "midpoint"):
        momenta = top_run(method, 0.05, steps)[3]
        assert np.ptp(momenta[:, [0, 2]], axis=0).max() == 0


@pytest.mark.slow
def test_claim_order_four_is_kept_while_midpoint_falls_to_zero_and_rk4_passes_six():
    orders = {
        method: observed_orders([nutation_error(method, 0.05 / 2**k, periods) for k in range(4)])
        for method, periods in (("simpson", 1000), ("midpoint", 1000), ("rk4", 100))
    }
    assert np.abs(orders["simpson"][1:] - 4).max() < 0.1
    assert np.abs(orders["midpoint"]).max() < 0.05
    assert orders["rk4"].max() > 6


@pytest.mark.slow
def test_claim_simpson_is_more_precise_than_rk4_at_equal_step():
    for periods in (1, 10, 100):
        for k in range(4):
            h = 0.05 / 2**k
            assert nutation_error("simpson", h, periods) < nutation_error("rk4", h, periods) / 3
    t, exact = pendulum_run("simpson", GRAVITY / TURN**2, 1e-4, 100_000)[:2]
    far = {}
    for scheme in ("simpson", "midpoint", "rk4"):
        q = pendulum_run(scheme, GRAVITY / TURN**2, 0.1, 100)[1]
        far[scheme] = np.abs(q - exact[::1000])[10::10].max()
    assert t[-1] == pytest.approx(10)
    assert far["simpson"] == pytest.approx(0.0023, abs=1e-4)
    assert far["rk4"] == pytest.approx(0.11, abs=0.01)
    assert far["midpoint"] == pytest.approx(1.06, abs=0.01)


@pytest.mark.slow
def test_a_step_that_divides_the_period_is_a_trap():
    """At h = period/37 a resonance holds the phase error, and the observed order is wrong."""
    period = float(exact_top().period)
    locked, free = (nutation_error("simpson", period / n, 1000) for n in (37, 37.3))
    assert locked == pytest.approx(8.50e-2, rel=5e-3)
    assert free > 0.5
    halved = nutation_error("simpson", period / 74, 1000)
    assert np.log2(locked / halved) == pytest.approx(1.39, abs=0.05)


@pytest.mark.slow
def test_the_printed_motion_is_regular():
    """Nearby starts of the double pendulum part linearly in time, not exponentially."""
    simpson = stepper("double_pendulum", "simpson")
    length = GRAVITY / TURN**2
    given = {"h": 0.02, "parameters": {"m1": 1, "m2": 1, "l1": length, "l2": length, "g": GRAVITY}}
    ends = [
        simpson.integrate(
            [math.pi / 4 + eps, math.pi / 3], p0=[0, 0], steps=50_000, every=5000, **given
        ).q
        for eps in (0, 1e-9)
    ]
    growth = np.abs(ends[1] - ends[0])[1:].max(axis=1) / 1e-9
    assert growth[-1] < 1500
    assert growth[-1] / growth[0] < 30
