"""The derivative of a run has the order of the scheme: against variational equations."""

import numpy as np
import pytest
from support.cases import sweep

import symsimpson as ss
from symsimpson.reference import canonical
from symsimpson.study.bench.contenders import to_heyoka

START = ([0.8, 1.0], [0.05, -0.02])


@pytest.fixture(scope="module")
def exact():
    """The derivative of the flow over one unit of time, by Taylor series."""
    heyoka = pytest.importorskip("heyoka")
    motion = to_heyoka(heyoka, canonical(ss.systems.double_pendulum()))
    equations = heyoka.var_ode_sys(motion, heyoka.var_args.vars, order=1)
    flow = heyoka.taylor_adaptive(equations, np.concatenate(START), tol=1e-16, compact_mode=True)
    flow.propagate_until(1.0)
    size = len(START[0]) * 2
    return flow.state[size:].reshape(size, size)


@pytest.mark.parametrize(
    ("scheme", "order", "steps"),
    sweep(
        [
            ("simpson", 4, (40, 80)),
            ("midpoint", 2, (80, 160)),
            ("lobatto6", 6, (40, 80)),
            ("gauss8", 8, (48, 96)),
        ],
        0,
    ),
)
def test_the_derivative_has_the_order_of_the_scheme(exact, scheme, order, steps):
    stepper, errors = ss.compile(ss.systems.double_pendulum(), scheme), []
    for count in steps:
        run = stepper.integrate(
            START[0], p0=START[1], h=1 / count, steps=count, tangents=4, every=None
        )
        errors.append(np.abs(run.tangent[0] - exact).max() / np.abs(exact).max())
    assert abs(np.log2(errors[0] / errors[1]) - order) < 0.2
