"""One compiled run of each form of code: the numbers of the same kernels in plain Python."""

import numpy as np
import pytest
from support.cases import sweep
from support.plain import plain

import symsimpson as ss

PENDULA, CHAIN = ss.systems.double_pendulum(), ss.systems.fermi_pasta_ulam()
#: System, scheme and what is asked for beside a start, h and steps.
FORMS = {
    "unrolled": (PENDULA, "simpson", {}),
    "by stages": (PENDULA, "gauss8", {}),
    "with constraints": (ss.systems.cartesian_pendulum(), "simpson", {}),
    "in their own time": (ss.systems.kepler_plane().retimed("encounters"), "simpson", {}),
    "with variations": (PENDULA, "simpson", {"tangents": 4}),
    "explicit": (CHAIN, "kahan_li8", {}),
    "driven": (ss.systems.driven_cart_pole(), "midpoint", {"inputs": {"u": [0.3] * 12}}),
    "with friction": (ss.systems.damped_pendulum(), "gauss4", {}),
    "in loops": (ss.systems.hanging_chain(), "simpson", {}),
    "with sensitivities": (PENDULA, "midpoint", {"sensitivities": ["l1", "g"]}),
    "in bands": (ss.systems.hanging_chain(24), "midpoint", {}),
    "of quaternions": (ss.systems.quaternion_top(), "simpson", {}),
}
KEPT = {"tangents": "tangent", "sensitivities": "sensitivity"}
STEPS = 12


def run_of(form, **how):
    system, scheme, more = FORMS[form]
    duration = {"t_end": 0.3} if "own time" in form else {"steps": STEPS}
    stepper = ss.compile(system, scheme)
    return stepper.integrate(**system.reference_state, h=0.02, **duration, **more, **how)


@pytest.mark.parametrize("form", sweep(FORMS, 3))
def test_a_form_has_the_numbers_of_plain_python(form):
    found = run_of(form)
    with pytest.MonkeyPatch.context() as patch, plain(patch):
        expected = run_of(form)
    for name in ("t", "q", "p", "v", "energy", *(KEPT[x] for x in FORMS[form][2] if x in KEPT)):
        one, other = getattr(found, name), getattr(expected, name)
        if isinstance(one, dict):
            one, other = np.array([*one.values()]), np.array([*other.values()])
        size = np.abs(other).max()
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-13 * size, err_msg=name)
    assert np.abs(found.newton_iterations - expected.newton_iterations).max() <= 1


@pytest.mark.slow
def test_lanes_have_the_numbers_of_plain_python():
    angles = np.random.default_rng(1).uniform(-1, 1, (11, 2))
    how = {"v0": [0.0, 0.0], "h": 0.02, "steps": STEPS}
    found = ss.compile(PENDULA, "simpson").ensemble(angles, **how)
    with pytest.MonkeyPatch.context() as patch, plain(patch):
        expected = ss.compile(PENDULA, "simpson").ensemble(angles, **how)
    np.testing.assert_allclose(found.q, expected.q, rtol=0, atol=1e-14)
    np.testing.assert_allclose(found.p, expected.p, rtol=0, atol=1e-14)
