"""Members that keep a time of their own."""

import numpy as np
import pytest
import sympy as sp
from support.cases import sweep

import symsimpson as ss

x, y = ss.coordinates("x y")
KEPLER = ss.MechanicalSystem(
    "kepler_members",
    coordinates=(x, y),
    kinetic=(x.diff() ** 2 + y.diff() ** 2) / 2,
    potential=-1 / sp.sqrt(x**2 + y**2),
)
ECCENTRICITY = np.linspace(0.1, 0.95, 5)
Q0 = np.column_stack([1 + ECCENTRICITY, 0 * ECCENTRICITY])
V0 = np.column_stack([0 * ECCENTRICITY, np.sqrt((1 - ECCENTRICITY) / (1 + ECCENTRICITY))])
HOW = [
    {"t_end": 8.0},
    {"t_end": 8.0, "every": 3},
    {"t_end": 8.0, "every": 1},
    {"steps": 20},
    {"steps": 20, "every": 7},
]


@pytest.fixture(params=["simpson", "gauss8", pytest.param("kahan_li8", marks=pytest.mark.slow)])
def stepper(request):
    return ss.compile(KEPLER.retimed("encounters"), request.param)


@pytest.mark.parametrize("how", sweep(HOW))
def test_members_are_single_runs(stepper, how):
    many = stepper.ensemble(Q0, v0=V0, h=0.1, **how)
    assert (many.status == ss.Status.SUCCESS).all()
    if "t_end" in how:
        assert np.ptp(many.steps) > 20  # each has steps of its own
    for k in range(len(many)):
        run = stepper.integrate(Q0[k], v0=V0[k], h=0.1, **{"every": None} | how)
        one, tau = many[k], np.atleast_1d(many.tau[k])[: len(run)]
        assert many.steps[k] == run.steps
        assert many.parameters["E0"][k] == pytest.approx(run.E0, rel=1e-15)
        for found, expected in ((one.t, run.t), (one.q, run.q), (one.p, run.p), (tau, run.tau)):
            np.testing.assert_allclose(found, expected, rtol=0, atol=1e-13)
    kept = np.isfinite(many.energy)
    np.testing.assert_array_equal(kept, np.isfinite(many.t))
    at_end = many.energy if many.energy.ndim == 1 else many.energy[:, 0]
    np.testing.assert_allclose(at_end, many.parameters["E0"], rtol=0, atol=2e-2)


def test_threads_and_order_change_no_bit(stepper):
    one = stepper.ensemble(Q0, v0=V0, h=0.1, t_end=8.0, threads=1)
    other = stepper.ensemble(Q0[::-1], v0=V0[::-1], h=0.1, t_end=8.0, threads=2)
    np.testing.assert_array_equal(one.q, other.q[::-1])
    np.testing.assert_array_equal(one.p, other.p[::-1])


def test_reductions_know_the_time_of_each_member(stepper):
    reduce = {
        "near": ("min", "sqrt(x**2 + y**2)"),
        "after": ("first", "t - 3"),
        "behind": ("first", "-x"),
    }
    many = stepper.ensemble(Q0, v0=V0, h=0.1, t_end=8.0, reduce=reduce)
    np.testing.assert_allclose(many["after"], 3.0, rtol=0, atol=1e-14)
    # a quarter of the orbit that ends above the focus, by Kepler's equation
    anomaly = np.arccos(-ECCENTRICITY)
    np.testing.assert_allclose(
        many["behind"], np.pi - np.arccos(ECCENTRICITY) + ECCENTRICITY * np.sin(anomaly), rtol=5e-3
    )
    np.testing.assert_allclose(many["near"], 1 - ECCENTRICITY, rtol=2e-2)


@pytest.mark.parametrize("every", sweep([None, 3]))
def test_reductions_see_the_end_of_single_runs_and_of_members(stepper, every):
    reduce = {
        "last": ("max", "t"),
        "least": ("min", "t + 10*energy"),
        "late": ("first", "t - 7.999"),
        "never": ("first", "t - 8.001"),
    }
    asked = {"h": 0.1, "t_end": 8.0, "every": every, "reduce": reduce}
    many = stepper.ensemble(Q0, v0=V0, **asked)
    assert (many["last"] == 8.0).all()
    np.testing.assert_allclose(many["late"], 7.999, rtol=1e-14)
    assert np.isnan(many["never"]).all()
    for k in range(len(many)):
        single = stepper.integrate(Q0[k], v0=V0[k], **asked).reduced
        for name, value in single.items():
            np.testing.assert_allclose(many[name][k], value, rtol=1e-12)
    back = asked | {"h": -0.1, "t_end": -8.0, "reduce": {"low": ("min", "t")}}
    assert stepper.integrate(Q0[0], v0=V0[0], **back).reduced == {"low": -8.0}


def test_what_cannot_begin_or_go_on_is_told_of_each(stepper):
    many = stepper.ensemble([[1.0, 0.0], [0.0, 0.0]], v0=[[0.0, 1.0], [0.0, 0.0]], h=0.1, t_end=5.0)
    assert many.status.tolist() == [ss.Status.SUCCESS, ss.Status.BAD_INPUT]
    assert np.isfinite(many.q[0]).all()


@pytest.mark.slow
def test_a_time_that_cannot_advance_is_rejected(stepper):
    with pytest.raises(ss.InputError, match="below round-off"):
        stepper.ensemble(Q0, v0=V0, h=0.1, t0=1e20, steps=3000)  # 16384 more is the next number


def test_table_of_members():
    pytest.importorskip("xarray")
    stepper = ss.compile(KEPLER.retimed("encounters"), "simpson")
    table = stepper.ensemble(Q0, v0=V0, h=0.1, t_end=2.0, every=4).to_xarray()
    assert table["t"].dims == table["tau"].dims == ("member", "time")
    assert table["E0"].dims == ("member",)


def test_refused(tmp_path):
    stepper = ss.compile(KEPLER.retimed("encounters"), "simpson")
    with pytest.raises(ss.InputError, match="not the mean over time"):
        stepper.ensemble(Q0, v0=V0, h=0.1, t_end=2.0, reduce={"x": ("mean", "x")})
    with pytest.raises(ss.InputError, match="Each member has its own times"):
        stepper.ensemble(Q0, v0=V0, h=0.1, t_end=2.0, store=tmp_path / "store")
    with pytest.raises(ss.InputError, match="follow from the initial state"):
        stepper.ensemble(Q0, v0=V0, h=0.1, t_end=2.0, parameters={"E0": 1.0})


def test_a_member_that_does_not_reach_its_end_says_so():
    """It falls to where ln x is no number."""
    (z,) = ss.coordinates("z")
    falling = ss.MechanicalSystem(
        "falling", coordinates=(z,), kinetic=z.diff() ** 2 / 2, potential=sp.log(z)
    )
    stepper = ss.compile(falling.retimed(sp.Integer(2)))
    how = {"h": 0.03, "t_end": 1.4}
    last = stepper.ensemble([[1.0]], v0=[0.0], **how)
    every = stepper.ensemble([[1.0]], v0=[0.0], **how, every=1)
    assert last.status.tolist() == every.status.tolist() == [ss.Status.NOT_FINITE]
    kept = every.t[0][np.isfinite(every.t[0])]
    assert (np.diff(kept) > 0).all()
    run = stepper.integrate([1.0], v0=[0.0], **how, on_failure="return")
    assert len(run.t) == len(run.tau)
    end = stepper.integrate([1.0], v0=[0.0], **how, every=None, on_failure="return")
    assert end.t[0] == run.t[end.steps]
    assert end.q[0] == run.q[end.steps]
