"""Runs that go wrong: never a hang, never a success, nothing lost."""

import numpy as np
import pytest
from support.cases import sweep
from support.places import ROOT

import symsimpson as ss
from symsimpson.run.integrate import start_run
from symsimpson.stepping.request import Request
from symsimpson.stepping.run import Run
from symsimpson.stepping.spec import read_run

PENDULUM = ss.systems.double_pendulum()
SHORT = {"l1": 0.25, "l2": 0.25}


def one_dimensional(name, potential):
    (x,) = ss.coordinates("x")
    return ss.MechanicalSystem(
        name, coordinates=(x,), kinetic=x.diff() ** 2 / 2, potential=potential(x), parameters={}
    )


@pytest.mark.parametrize(
    ("name", "potential"),
    sweep(
        [
            ("centre", lambda x: -1 / x),
            ("well", lambda x: -1 / x**2),
            ("blow_up", lambda x: -(x**4)),
        ]
    ),
)
def test_singular_motion_ends_with_a_status(name, potential):
    stepper = ss.compile(one_dimensional(name, potential))
    with pytest.raises(ss.ConvergenceError, match=rf"{name}, simpson: step \d+ of 2000") as caught:
        stepper.integrate([1.0], v0=[0.1 if name == "blow_up" else 0.0], h=0.01, steps=2000)
    error = caught.value
    run = error.trajectory
    assert error.status == run.status != 0
    assert error.step == run.steps == len(run) - 1
    assert error.time == pytest.approx(run.t[-1])
    assert error.residual >= 0 or np.isnan(error.residual)
    assert np.isfinite(run.q).all()
    assert run.status.message in run.message
    again = stepper.integrate([1.0], p0=run.p[0], h=0.01, steps=2000, on_failure="return")
    assert again.status == error.status
    assert (again.q == run.q).all()


@pytest.mark.slow
def test_leaving_the_domain_is_not_finite():
    import sympy as sp

    stepper = ss.compile(one_dimensional("wall", lambda x: sp.log(x)))
    run = stepper.integrate([0.05], v0=[-3.0], h=0.05, steps=100, on_failure="return")
    assert run.status != 0
    assert np.isfinite(run.q).all()


@pytest.mark.parametrize("scheme", sweep(["simpson", "midpoint"]))
@pytest.mark.parametrize("h", [0.2, 0.3, 0.5, 1.0, 3.0])
def test_large_steps_never_jump_to_another_solution(scheme, h):
    """Where the step is far too large, no accepted step multiplies the energy."""
    stepper = ss.compile(PENDULUM, scheme)
    run = stepper.integrate(
        [2.5, 2.0], v0=[0, 3.0], h=h, steps=300, parameters=SHORT, on_failure="return"
    )
    assert run.status != 0
    assert np.isfinite(run.q).all()
    assert "smaller h" in run.message


def test_a_found_solution_is_the_one_that_small_steps_lead_to():
    """At coarse but sensible steps the rescue must not refuse what is right."""
    for h in (0.05, 0.1):
        run = ss.compile(PENDULUM).integrate(**PENDULUM.reference_state, h=h, t_end=100.0)
        assert run.status == 0
        assert np.abs(run.energy_error).max() < 1e-3


@pytest.mark.parametrize("every", [1, None])
def test_interrupt(monkeypatch, every):
    stepper = ss.compile(PENDULUM, "midpoint")
    whole = stepper.integrate([0.5, 0.2], p0=[0, 0], h=0.01, steps=50)
    advance = Run.advance

    def interrupted(self, stop):
        advance(self, 20)
        raise KeyboardInterrupt

    monkeypatch.setattr(Run, "advance", interrupted)
    with pytest.raises(ss.Interrupted) as caught:
        stepper.integrate([0.5, 0.2], p0=[0, 0], h=0.01, steps=50, every=every, progress=False)
    run = caught.value.trajectory
    assert isinstance(caught.value, KeyboardInterrupt)
    assert "the run was interrupted at t=0.2, after step 20" in str(caught.value)
    assert "states computed so far are in this error's .trajectory" in str(caught.value)
    assert run.steps == 20
    assert (run.q[-1] == whole.q[20]).all()
    how = {"h": 0.01, "steps": 50, "every": every, "progress": False}  # no short run
    returned = stepper.integrate([0.5, 0.2], p0=[0, 0], **how, on_failure="return")
    assert returned.status is ss.Status.INTERRUPTED


def test_huge_angles_take_the_robust_kernels():
    """Beyond the domain of the fast sine the run goes on with the library's."""
    stepper = ss.compile(ss.systems.pendulum(), "midpoint")
    turns = 2 * np.pi * 2**27
    far = stepper.integrate([1.0 + turns], v0=[0.0], h=0.01, steps=100)
    near = stepper.integrate([np.fmod(1.0 + turns, 2 * np.pi)], v0=[0.0], h=0.01, steps=100)
    assert far.q[0, 0] > 5e8
    assert np.abs((far.q - far.q[0]) - (near.q - near.q[0])).max() < 1e-6


@pytest.mark.parametrize("scheme", sweep(["simpson", "midpoint"]))
@pytest.mark.parametrize(
    ("system", "h"),
    sweep(
        [(PENDULUM, 0.02), (ss.systems.lagrange_top(), 0.01), (ss.systems.fermi_pasta_ulam(), 0.01)]
    ),
    ids=lambda value: getattr(value, "name", str(value)),
)
def test_stopping_leaves_no_trace(system, h, scheme):
    """K and K steps are 2 K steps, to the last bit of the whole workspace."""
    stepper = ss.compile(system, scheme)
    state = system.reference_state
    runs = [Run(stepper.program, stepper.program.defaults, h, 0.0, (1, 401)) for _ in range(2)]
    for run in runs:
        velocity = "v0" in state
        run.begin(
            np.array(state["q0"]), np.array(state["v0" if velocity else "p0"]), velocity=velocity
        )
    runs[0].advance(400)
    for stop in (1, 2, 137, 138, 400):
        runs[1].advance(stop)
    assert (runs[0].W == runs[1].W).all()
    assert (runs[0].q == runs[1].q).all()
    assert (runs[0].iterations == runs[1].iterations).all()


def test_stopping_leaves_no_trace_where_steps_are_recovered(monkeypatch):
    stepper = ss.compile(PENDULUM)
    values = stepper.program.values(SHORT)
    numbers, recovered = type(stepper.program.numbers), []

    def counted(self, name, original=numbers.driver, **how):
        if name == "recover":
            recovered.append(name)
        return original(self, name, **how)

    monkeypatch.setattr(numbers, "driver", counted)
    runs = [Run(stepper.program, values, 0.1, 0.0, (1, 41)) for _ in range(2)]
    for run in runs:
        run.begin(np.array([2.5, 2.0]), np.array([0.0, 3.0]), velocity=True)
    runs[0].advance(40)
    for stop in range(1, 41):
        runs[1].advance(stop)
    assert len(recovered) >= 4
    assert (runs[0].W == runs[1].W).all()
    assert (runs[0].q == runs[1].q).all()


@pytest.mark.slow
def test_a_singular_jacobian_has_its_status():
    """At rest on a hill, with h^2 K = -4 M: the midpoint step is any step."""
    stepper = ss.compile(one_dimensional("hill", lambda x: x**4 - 2 * x**2), "midpoint")
    run = stepper.integrate([0.0], v0=[0.0], h=1.0, steps=3, on_failure="return")
    assert run.status is ss.Status.SINGULAR_JACOBIAN
    assert "Try another h" in run.message
    assert stepper.integrate([0.0], v0=[0.0], h=0.9, steps=3).status == 0


@pytest.mark.filterwarnings("ignore::symsimpson.errors.StabilityWarning")
def test_divergence_has_its_status():
    stepper, begun = ss.compile(PENDULUM), {"q0": [1.0, 2.0], "h": 4.0, "steps": 5}
    # half of all starts diverge with such a step: rounding tells which
    velocities = [[0.0, float(k)] for k in range(1, 13)]
    runs = [stepper.integrate(**begun, v0=v, on_failure="return") for v in velocities]
    diverged = [run.status for run in runs].index(ss.Status.DIVERGED)
    with pytest.raises(ss.ConvergenceError, match="diverged"):
        stepper.integrate(**begun, v0=velocities[diverged])


@pytest.mark.parametrize("status", ["NOT_CONVERGED", "DIVERGED", "NOT_FINITE", "STEP_TOO_LARGE"])
def test_a_blow_up_is_told_where_one_may_end_a_run(status):
    assert "runs to infinity: look at the sign" in ss.Status[status].message


def test_every_status_is_told():
    page = (ROOT / "notebooks/guide/status.md").read_text()
    for status in ss.Status:
        assert status.message.endswith((".", "kept."))
        assert f"| `{status.name}` |" in page


BLOCKS = (
    "POSITION",
    "POSITION_LOW",
    "MOMENTUM",
    "MOMENTUM_LOW",
    "INCREMENT",
    "PREDICTED",
    "PREVIOUS",
    "SOLVED",
    "VELOCITY",
    "PARAMETER",
    "HOISTED",
    "MASS_DIAGONAL",
    "LARGEST_SQUARED",
    "NODE_L_Q",
    "RESIDUAL",
    "JACOBIAN",
    "STAGE_V",
    "STAGE_F",
)


@pytest.mark.parametrize("scheme", sweep(["simpson", "midpoint", "gauss8"]))
def test_injected_nan_and_infinity(scheme):
    """210 of them, into what a run has computed: it fails, or goes on as before."""
    stepper = ss.compile(PENDULUM, scheme)
    start = PENDULUM.reference_state
    program = stepper.program
    spec = read_run(program, Request(**start, h=0.01, steps=60))
    whole = stepper.integrate(**start, h=0.01, steps=60, every=None)
    random = np.random.default_rng(7)
    failed = 0
    for trial in range(70):
        run = start_run(program, spec, 0, 1)
        run.advance(20)
        block = BLOCKS[trial % len(BLOCKS)]
        if block not in stepper.program.header.layout:
            block = "POSITION"
        row = stepper.program.header.layout[block] + int(random.integers(2))
        run.W[row, 0] = (np.nan, np.inf, -np.inf)[trial % 3]
        run.advance(60)
        if run.alive:
            assert run.step == 60
            gap = np.abs(run.rows("POSITION", 2) - whole.q[0]).max()
            assert gap < 1e-13, (block, row, gap)  # it was not used, or only as a guess
        else:
            failed += 1
            assert run.status is not ss.Status.SUCCESS
            assert run.step < 60
    assert failed > 10


@pytest.mark.parametrize("every", [1, 20, None])
def test_a_step_that_fails_where_bars_fold_tells_of_the_constraints(every):
    """Two equal cranks and a bar between them, which lie in a line at the angle pi."""
    a, b, c, d = ss.coordinates("a b c d")
    system = ss.MechanicalSystem(
        "parallelogram",
        coordinates=(a, b, c, d),
        kinetic=sum(q.diff() ** 2 for q in (a, b, c, d)) / 2,
        potential=0 * a,
        constraints={
            "left": a**2 + b**2 - 1,
            "right": (c - 2) ** 2 + d**2 - 1,
            "top": (a - c) ** 2 + (b - d) ** 2 - 4,
        },
    )
    stepper = ss.compile(system, "suzuki4")
    cos, sin = np.cos(3), np.sin(3)
    start = {"q0": [cos, sin, 2 + cos, sin], "v0": [-sin, cos, -sin, cos], "every": every}
    run = stepper.integrate(**start, h=0.005, steps=60, on_failure="return")
    assert run.status is ss.Status.NOT_FINITE
    assert "'left', 'right', 'top' become linearly dependent there" in run.message
    fast = start | {"v0": [-2000 * sin, 2000 * cos] * 2}
    far = stepper.integrate(**fast, h=0.005, steps=60, on_failure="return")
    assert not far.success
    assert "linearly dependent" not in far.message  # the step is too large
