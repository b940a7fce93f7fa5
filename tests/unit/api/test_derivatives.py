"""Derivatives of steps and runs: what they are, and what is said where there are none."""

from itertools import combinations

import mpmath as mp
import numpy as np
import pytest
import sympy as sp
from support.cases import sweep

import symsimpson as ss
from symsimpson.stepping.inputs import program_with_derivatives

H = 0.01


def symplectic_defect(D):
    n = len(D) // 2
    J = np.block([[np.zeros((n, n)), np.eye(n)], [-np.eye(n), np.zeros((n, n))]])
    return np.abs(D.T @ J @ D - J).max() / np.abs(D).max() ** 2


@pytest.fixture
def pendulum():
    return ss.compile(ss.systems.pendulum())


def started(system):
    state = dict(system.reference_state)
    return state.pop("q0"), state


def assert_paths_agree(system, scheme, precision, within):
    found = []
    for exploit in ("all", ()):
        stepper = ss.compile(system, scheme, exploit=exploit, precision=precision)
        q0, given = started(system)
        run = stepper.integrate(
            q0,
            **given,
            h=H,
            steps=3 if precision else 20,
            tangents=2 * stepper.n,
            sensitivities=stepper.parameters[:1],
        )
        columns = [column[-1][:, None] for column in run.sensitivity.values()]
        found.append(np.concatenate([run.tangent[-1], *columns], axis=1))
        if not stepper.program.header.forces:
            assert symplectic_defect(run.tangent[-1]) < within
    assert np.abs(found[0] - found[1]).max() < within * np.abs(found[1]).max()


@pytest.mark.parametrize(
    "name",
    sweep(
        [
            "heavy_top",
            "harmonic_oscillator",
            "henon_heiles",
            "lagrange_top",
            "fermi_pasta_ulam",
            "kepler",
            "cart_pole",
            "damped_oscillator",
        ],
        0,
    ),
)
def test_reduced_paths_have_the_derivatives_of_the_general_one(name):
    assert_paths_agree(getattr(ss.systems, name)(), "simpson", None, 1e-13)


@pytest.mark.slow
@pytest.mark.parametrize("name", sweep(ss.systems.CATALOGUE, 2))
@pytest.mark.parametrize("scheme", sweep(["simpson", "gauss6", "midpoint"], 1))
def test_reduced_paths_have_its_derivatives_in_many_digits(name, scheme):
    assert_paths_agree(ss.systems.CATALOGUE[name](), scheme, 40, 1e-33)


def test_carrying_derivatives_along_does_not_change_a_run(pendulum):
    plain = pendulum.integrate([1.0], v0=[0.5], h=H, steps=100)
    varied = pendulum.integrate([1.0], v0=[0.5], h=H, steps=100, tangents=2, sensitivities=("g",))
    assert np.array_equal(plain.q, varied.q)
    assert np.array_equal(plain.p, varied.p)


@pytest.mark.slow
@pytest.mark.parametrize("precision", [40, pytest.param(None, marks=pytest.mark.slow)])
def test_steps_by_stages_have_the_derivatives_of_newtons_method(precision, monkeypatch):
    """Nodes that are iterated leave the path that steps are differentiated by."""
    system, found, iterations = ss.systems.elastic_pendulum(), [], []
    stepper = ss.compile(system, "gauss10", precision=precision)  # fewer stages: Newton's
    kernels = program_with_derivatives(stepper.program, ("k",)).kernels
    q0, given = started(system)
    given |= {"h": 0.125, "steps": 4}
    for first in (0, 1):  # stages, then Newton's method alone
        monkeypatch.setattr(kernels, "fallbacks", kernels.fallbacks[first:])
        run = stepper.integrate(q0, **given, tangents=4, sensitivities="k")
        back = stepper.gradient(q0, **given, cost="r**2", wrt=("q", "k"))
        found.append([run.tangent[-1], run.sensitivity["k"][-1], *back.parts.values()])
        iterations.append(run.newton_iterations[1:].mean())
    assert kernels.by_stages
    assert iterations[0] > 2 * iterations[1]
    for stages, newton in zip(*found, strict=True):
        error = np.max(np.abs(stages - newton)) / np.max(np.abs(newton))
        assert error < (1e-33 if precision else 1e-13)


@pytest.mark.slow
def test_derivatives_are_those_of_the_stored_states(pendulum):
    whole = pendulum.integrate([1.0], v0=[0.5], h=H, steps=40, tangents=2, sensitivities="l")
    some = pendulum.integrate(
        [1.0], v0=[0.5], h=H, steps=40, tangents=2, sensitivities="l", every=8
    )
    last = pendulum.integrate([1.0], v0=[0.5], h=H, steps=40, tangents=[0, 1], every=None)
    assert np.array_equal(whole.tangent[::8], some.tangent)
    assert np.array_equal(whole.sensitivity["l"][::8], some.sensitivity["l"])
    assert np.allclose(whole.tangent[-1][:, 1], last.tangent[0, :, 0], rtol=1e-15)


@pytest.mark.slow
def test_velocities_that_are_given_stay_when_a_parameter_changes(pendulum):
    """p0 = m l^2 v0 changes with l then; a difference sees it."""
    run = pendulum.integrate([1.0], v0=[0.5], h=H, steps=50, sensitivities="l")
    values = dict(zip(pendulum.parameters, pendulum.program.defaults, strict=True))

    def end(l):
        return pendulum.integrate([1.0], v0=[0.5], h=H, steps=50, parameters={"l": l}).y[:, -1]

    ends = [end(values["l"] + e) for e in (1e-5, -1e-5)]
    assert np.abs((ends[0] - ends[1]) / 2e-5 - run.sensitivity["l"][-1]).max() < 1e-8


def test_a_step_with_its_derivative(pendulum):
    q1, p1, D = pendulum.tangent([1.0], p=[0.2], h=H, wrt=("q", "l", "p"))
    assert np.array_equal([q1, p1], pendulum.step([1.0], p=[0.2], h=H))
    assert D.shape == (2, 3)
    assert abs(np.linalg.det(D[:, [0, 2]]) - 1) < 1e-15


def test_what_cannot_be_differentiated_is_refused(pendulum):
    with pytest.raises(ss.InputError, match="no parameter or input"):
        pendulum.integrate([1.0], v0=[0.0], h=H, steps=1, sensitivities="x")
    with pytest.raises(ss.InputError, match="the state has 2 numbers"):
        pendulum.integrate([1.0], v0=[0.0], h=H, steps=1, tangents=3)
    with pytest.raises(ss.InputError, match="the shape must be \\(2, k\\)"):
        pendulum.integrate([1.0], v0=[0.0], h=H, steps=1, tangents=np.eye(3))
    with pytest.raises(ss.InputError, match="Pass tangents=2 for the full derivative"):
        pendulum.integrate([1.0], v0=[0.0], h=H, steps=1, tangents=True)
    with pytest.raises(ss.InputError, match="did not compute derivatives of this kind"):
        _ = pendulum.integrate([1.0], v0=[0.0], h=H, steps=1).tangent
    explicit = ss.compile(ss.systems.henon_heiles(), "blanes_moan4")
    with pytest.raises(ss.SchemeError, match="kicks and drifts"):
        explicit.tangent([0.1, 0.1], p=[0.0, 0.0], h=H)


def test_a_module_from_a_file_differentiates_if_it_was_made_to(tmp_path):
    system = ss.systems.pendulum()
    plain = ss.load(ss.generate(system, "midpoint", tmp_path / "plain"))
    with pytest.raises(ss.InputError, match="does not differentiate"):
        plain.tangent([1.0], p=[0.0], h=H)
    varied = ss.load(ss.generate(system, "midpoint", tmp_path / "varied", derivatives=("l",)))
    D = varied.tangent([1.0], p=[0.0], h=H, wrt=("q", "p", "l"))[2]
    assert np.array_equal(
        D, ss.compile(system, "midpoint").tangent([1.0], p=[0.0], h=H, wrt=("q", "p", "l"))[2]
    )
    for wrong in (("x",), "x", True, [3]):
        with pytest.raises(ss.GenerationError, match="no parameter or input"):
            ss.generate(system, "midpoint", tmp_path, derivatives=wrong)
    (length,) = (x for x in system.parameters if x.name == "l")
    one = ss.generate(system, "midpoint", tmp_path / "one", derivatives=length)
    assert one.read_bytes() == (tmp_path / "varied" / one.name).read_bytes()


@pytest.mark.parametrize(
    ("name", "scheme"),
    sweep(
        [
            ("double_pendulum", "simpson"),
            ("heavy_top", "gauss4"),
            ("pendulum", "gauss8"),
            ("cartesian_pendulum", "simpson"),
        ],
        0,
    ),
)
@pytest.mark.parametrize("every", sweep([8, None], 1))
def test_members_of_an_ensemble_carry_what_single_runs_do(name, scheme, every):
    system = getattr(ss.systems, name)()
    stepper = ss.compile(system, scheme)
    q0, given = started(system)
    varied = stepper.parameters[:2]
    scales = np.linspace(0.9, 1.1, 11)
    values = {varied[0]: stepper.program.defaults[0] * scales}
    many = stepper.ensemble(
        np.tile(q0, (11, 1)),
        **given,
        h=H,
        steps=32,
        every=every,
        parameters=values,
        tangents=2,
        sensitivities=varied,
    )
    for k in (0, 5, 10):
        one = stepper.integrate(
            q0,
            **given,
            h=H,
            steps=32,
            every=every,
            parameters={varied[0]: values[varied[0]][k]},
            tangents=2,
            sensitivities=varied,
        )
        own = one.tangent if every else one.tangent[0]
        assert many.tangent[k].shape == own.shape
        assert np.abs(many.tangent[k] - own).max() < 1e-12 * np.abs(own).max()
        for key in varied:
            own = one.sensitivity[key] if every else one.sensitivity[key][0]
            assert np.abs(many.sensitivity[key][k] - own).max() < 1e-12 * np.abs(own).max()


@pytest.mark.slow
def test_members_that_fail_have_the_derivative_of_their_last_state(pendulum):
    many = pendulum.ensemble([[1.0], [np.pi]], v0=[[0.5], [1e300]], h=H, steps=3, tangents=1)
    assert many.status[1] != 0
    assert np.isnan(many.q[1]).all()  # it did not begin: its energy is not finite
    assert np.isnan(many.tangent[1]).all()
    assert np.isfinite(many.tangent[0]).all()
    with pytest.raises(ss.InputError, match="cannot be combined with"):
        pendulum.ensemble([[1.0]], v0=[0.5], h=H, steps=30, tangents=1, reduce={"l": "lyapunov"})


@pytest.mark.slow
def test_members_keep_what_they_carry_over_long_runs(pendulum):
    """A block is left now and then on its way, and what it has stored stays."""
    given = {"v0": [0.0], "h": H, "steps": 6000, "every": 500, "tangents": 2}
    many = pendulum.ensemble([[1.0], [0.5]], **given)
    for k, angle in enumerate((1.0, 0.5)):
        one = pendulum.integrate([angle], **given).tangent
        assert np.abs(many.tangent[k] - one).max() < 1e-9 * np.abs(one).max()


@pytest.mark.slow
@pytest.mark.parametrize("reduce", [None, {"highest": ("max", "theta")}])
@pytest.mark.parametrize("every", [None, 8])
def test_members_that_are_run_by_themselves_carry_as_much(pendulum, reduce, every):
    """Where fast sines have no value."""
    far, given = 1e9 + 1, {"v0": [0.0], "h": H, "steps": 32, "every": every, "tangents": 2}
    many = pendulum.ensemble([[1.0], [far]], **given, reduce=reduce)
    one = pendulum.integrate([far], **given)
    assert (many.status == 0).all()
    assert np.array_equal(many.tangent[1], one.tangent if every else one.tangent[0])


@pytest.mark.slow
def test_a_constant_mass_keeps_its_factors_beside_variations():
    n = 9
    q = ss.coordinates(" ".join(f"x{i}" for i in range(n)))
    v = [x.diff() for x in q]
    kinetic = sum(w**2 for w in v) / 2 + sum(a * b for a, b in combinations(v, 2)) / sp.Integer(24)
    potential = sum(1 / (1 + (a - b) ** 2) for a, b in combinations(q, 2))
    system = ss.MechanicalSystem("tied", coordinates=q, kinetic=kinetic, potential=potential)
    stepper = ss.compile(system, precision=20)
    asked = {"q0": [0.1 * k for k in range(n)], "p0": [0.2] * n, "h": 0.125, "steps": 3}
    plain, varied = stepper.integrate(**asked), stepper.integrate(**asked, tangents=1)
    assert "range(NODES)" in stepper.source
    assert plain.newton_iterations.tolist() == varied.newton_iterations.tolist()
    assert abs(plain.q - varied.q).max() < 1e-18


@pytest.mark.slow
@pytest.mark.parametrize("scheme", sweep(["midpoint", "simpson", "gauss6", "gauss10"], 2))
@pytest.mark.parametrize("name", ["one", "two", "canonical"])
def test_driven_runs_are_differentiated_by_h(name, scheme):
    """A change of h moves the times of all steps; a difference in many digits sees it."""
    x, y = ss.coordinates("x y")
    w, c = sp.symbols("w c", positive=True)
    px, py = sp.symbols("px py", real=True)
    drive, values = sp.cos(w * ss.time), {w: 1.3, c: 0.1}
    if name == "one":
        system = ss.MechanicalSystem(
            name,
            coordinates=(x,),
            kinetic=x.diff() ** 2 / 2,
            potential=x**2 / 2 + x**4 / 4 - x * drive,
            parameters=values,
            forces={x: -c * x.diff()},
        )
    elif name == "two":
        system = ss.MechanicalSystem(
            name,
            coordinates=(x, y),
            kinetic=(1 + y**2) * x.diff() ** 2 / 2 + y.diff() ** 2 / 2,
            potential=x**2 / 2 + y**4 / 4,
            parameters=values,
            forces={x: -c * x.diff() + drive, y: x * drive},
        )
    else:
        if scheme == "simpson":
            pytest.skip("it does not integrate a Hamiltonian")
        system = ss.HamiltonianSystem(
            name,
            coordinates=(x, y),
            momenta=(px, py),
            hamiltonian=(px**2 + py**2) / 2 + px * y / 3 + x**2 / 2 + y**4 / 4 + x * drive,
            parameters={w: 1.3},
        )
    n = system.n
    start = {"q0": [0.3, 0.4][:n], "p0": [0.1, 0.2][:n], "steps": 9, "t0": 0.4}
    run = ss.compile(system, scheme).integrate(**start, h=0.1, sensitivities="h")
    exact = ss.compile(system, scheme, precision=40)
    with mp.workdps(40):
        step = mp.mpf(10) ** -14
        ends = [exact.integrate(**start, h=mp.mpf(0.1) + e).y[:, -1] for e in (step, -step)]
        difference = np.array((ends[0] - ends[1]) / (2 * step), dtype=float)
    assert np.abs(run.sensitivity["h"][-1] - difference).max() < 1e-12
    many = ss.compile(system, scheme).ensemble(**start, h=0.1, sensitivities="h")
    assert np.abs(many.sensitivity["h"][0] - difference).max() < 1e-12
    with pytest.raises(ss.InputError, match="gradient by h is not available"):
        ss.compile(system, scheme).gradient(**start, h=0.1, cost=x**2, wrt="h")
