"""The compiled loop: no allocation, the GIL released, few and predictable iterations."""

import numpy as np
import pytest
from numba import njit

import symsimpson as ss
from symsimpson.program import driver as compiled
from symsimpson.targets.llvm.intrinsics import function_intrinsic, read_functions, stub
from symsimpson.text.driver import steps as text


def test_a_step_allocates_nothing():
    for name, allocates in (("take_steps", False), ("recover", True)):
        signature = compiled.signatures()[name]
        made = {}
        exec(stub(name, len(signature.args)), made)
        made[f"walk_{name}"] = function_intrinsic(
            lambda: read_functions(compiled.driver_text()), name, signature, 128
        )
        (code,) = njit(signature, **text.DRIVER_OPTIONS)(made[name]).inspect_llvm().values()
        assert ("malloc" in code) is allocates
        assert "NRT_Allocate" not in code
    assert text.DRIVER_OPTIONS["nogil"]


@pytest.mark.slow
def test_other_threads_run_meanwhile():
    """What is called from Python lets go of the interpreter."""
    for name in ("begin", "take_steps", "take_explicit_steps", "recover", "advance_blocks"):
        assert compiled.driver(name).targetoptions["nogil"]


def test_predictor_and_stop_save_iterations():
    """Mean iterations a step on the double pendulum, after the first ten steps."""
    system = ss.systems.double_pendulum()
    stepper = ss.compile(system)
    for h, most in ((0.1, 3.5), (0.02, 2.1), (0.1 / 43, 1.99), (0.1 / 512, 1.02)):
        run = stepper.integrate(**system.reference_state, h=h, steps=4000)
        assert run.newton_iterations[10:].mean() < most
        assert run.newton_iterations[1] <= 6


def test_newton_stops_at_round_off():
    """What the stop rule leaves undone is lost in rounding."""
    system = ss.systems.double_pendulum()
    stepper = ss.compile(system)
    for h in (0.1, 0.02, 0.005):
        run = stepper.integrate(**system.reference_state, h=h, steps=50)
        for q0, p0, q1 in zip(run.q[:-1], run.p[:-1], run.q[1:], strict=True):
            nodes = np.array([(q0 + q1) / 2, q1])
            for _ in range(6):
                R = stepper.residual(q0, p0, nodes, h)
                nodes -= np.linalg.solve(stepper.jacobian(q0, p0, nodes, h), R).reshape(2, 2)
            assert np.abs(nodes[-1] - q1).max() < 2e-15
