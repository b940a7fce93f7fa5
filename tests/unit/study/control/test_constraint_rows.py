"""Optimal control where constraints hold: positions, velocities, and both."""

import dataclasses

import numpy as np
import pytest
import sympy as sp
from support.cases import sweep
from support.control import check_derivatives

import symsimpson as ss
from symsimpson.study.control import solution
from symsimpson.study.control.constraint_rows import follows_constraints

pytest.importorskip("casadi")

x, y, z, th = ss.coordinates("x y z th")
u, f, tau = sp.symbols("u f tau", real=True)
l = sp.Symbol("l", positive=True)
LENGTH, GRAVITY = 0.7, sp.Rational(981, 100)
#: A pendulum that is pushed along x, and has friction, in the plane and by its angle.
PLANE = ss.MechanicalSystem(
    "bob",
    coordinates=(x, y),
    kinetic=(x.diff() ** 2 + y.diff() ** 2) / 2,
    potential=GRAVITY * y,
    parameters={l: LENGTH},
    constraints={"rod": x**2 + y**2 - l**2},
    forces={x: u - x.diff() / 10, y: -y.diff() / 10},
    inputs=(u,),
)
ANGLE = ss.MechanicalSystem(
    "pendulum",
    coordinates=(th,),
    kinetic=l**2 * th.diff() ** 2 / 2,
    potential=-GRAVITY * l * sp.cos(th),
    parameters={l: LENGTH},
    forces={th: u * l * sp.cos(th) - l**2 * th.diff() / 10},
    inputs=(u,),
)
#: A blade that is ahead of the centre of mass, pushed along and turned.
SLEIGH = ss.MechanicalSystem(
    "sleigh",
    coordinates=(x, y, th),
    kinetic=(x.diff() ** 2 + y.diff() ** 2) / 2 + th.diff() ** 2 / 6,
    potential=0,
    velocity_constraints={"blade": sp.cos(th) * y.diff() - sp.sin(th) * x.diff() - th.diff() / 4},
    forces={x: f * sp.cos(th), y: f * sp.sin(th), th: tau},
    inputs=(f, tau),
)
#: Both kinds, with masses that move, a row that moves with time, and a parameter in each.
BOTH = ss.MechanicalSystem(
    "both",
    coordinates=(x, y, z, th),
    kinetic=(x.diff() ** 2 + (1 + x**2) * y.diff() ** 2 + z.diff() ** 2 + th.diff() ** 2) / 2,
    potential=x * z,
    parameters={l: LENGTH},
    constraints={"bowl": z - l * x**2 - y**2},
    velocity_constraints={"wheel": sp.cos(th) * y.diff() - l * x * x.diff() - sp.sin(ss.time)},
    forces={x: u, th: f - th.diff() / 3},
    inputs=(u, f),
)


def bob(angle, rate):
    """Return a state of the pendulum in the plane."""
    s, c = LENGTH * np.sin(angle), LENGTH * np.cos(angle)
    return {x: s, y: -c, x.diff(): c * rate, y.diff(): s * rate}


def swing(plane=True, start=(0.3, 0.5), end=(2.0, 0.0), **more):
    ends = [
        bob(*one) if plane else dict(zip((th, th.diff()), one, strict=True)) for one in (start, end)
    ]
    given = {"cost": u**2, "start": ends[0], "end": ends[1], "duration": 1.5, **more}
    return ss.OptimalControl(PLANE if plane else ANGLE, **given)


def parked(**more):
    rest = {q.diff(): 0 for q in SLEIGH.coordinates}
    given = {"cost": f**2 + tau**2, "duration": 4, "start": {x: 0, y: 0, th: 0, **rest}}
    return ss.OptimalControl(SLEIGH, **given, end={x: 0, y: 1, th: 0, **rest}, **more)


@pytest.mark.parametrize("scheme", sweep(["gauss4", "simpson", "lobatto6"]))
def test_derivatives_are_exact(scheme):
    """With the duration and a parameter to be found, which stand in both constraints."""
    problem = ss.OptimalControl(
        BOTH,
        cost=u**2 + f**2 + x**4,
        start={x: 0.2, th: 0.1, x.diff(): 0.3},
        duration=(0.8, 2.0),
        unknowns={l: (0.5, 1.0)},
    )
    check_derivatives(problem, scheme)


@pytest.mark.parametrize(
    ("scheme", "order"), sweep([("simpson", 4), ("midpoint", 2), ("gauss6", 6)])
)
def test_a_pendulum_in_the_plane_costs_what_its_angle_costs(scheme, order):
    right = swing(plane=False).solve("gauss8", steps=40).cost
    found = [swing().solve(scheme, steps=steps) for steps in (20, 40)]
    off = [abs(one.cost - right) for one in found]
    assert abs(np.log2(off[0] / off[1]) - order) < 0.15
    assert off[1] < {2: 0.3, 4: 6e-4, 6: 4e-7}[order]
    assert np.abs(found[1].trajectory.constraint_error).max() < 1e-12


@pytest.mark.parametrize("scheme", sweep(["simpson", "gauss4", "midpoint"]))
@pytest.mark.parametrize("problem", [swing, parked])
def test_the_motion_is_a_run_of_the_scheme(problem, scheme):
    found = problem().solve(scheme, steps=12)
    assert found.success, found.message
    given = {name: found.input_values[..., j] for j, name in enumerate(found.layout.problem.inputs)}
    run = ss.compile(found.layout.problem.system, scheme).integrate(
        found.q[0], p0=found.p[0], h=found.duration / 12, steps=12, inputs=given
    )
    assert np.abs(run.q - found.q).max() < 1e-11
    assert np.abs(run.p - found.p).max() < 1e-11


@pytest.mark.slow
def test_a_sleigh_is_parked_aside_with_the_order_of_the_scheme():
    right = parked().solve("gauss8", steps=40)
    costs = [parked().solve("lobatto6", steps=n, guess=right).cost for n in (10, 20)]
    off = [abs(cost - right.cost) for cost in costs]
    assert abs(np.log2(off[0] / off[1]) - 6) < 0.3
    blade = ss.compile(SLEIGH, "gauss8").integrate(
        right.q[0],
        p0=right.p[0],
        h=0.1,
        steps=40,
        inputs={name: right.input_values[..., j] for j, name in enumerate(("f", "tau"))},
    )
    assert np.abs(blade.velocity_constraint_error).max() < 1e-13
    assert np.abs(blade.q[-1] - [0, 1, 0]).max() < 1e-9


def test_costates_are_derivatives_of_the_least_cost():
    """Along what the constraint allows, against differences of the costs of other starts."""

    def least(angle, rate):
        return swing(start=(angle, rate)).solve("simpson", steps=12, tolerance=1e-11)

    by_q, by_p = (one[0] for one in least(0.3, 0.5).costates)
    d = 1e-4
    for way in ((1, 0), (0, 1)):
        ends = [least(0.3 + k * d * way[0], 0.5 + k * d * way[1]) for k in (1, -1)]
        moved = [ends[0].q[0] - ends[1].q[0], ends[0].p[0] - ends[1].p[0]]
        right = (ends[0].cost - ends[1].cost) / (2 * d)
        assert abs((by_q @ moved[0] + by_p @ moved[1]) / (2 * d) - right) < 2e-6 * abs(right)


@pytest.mark.parametrize("problem", [lambda: swing(start=(0.3, 0.5)), lambda: parked()])
def test_costates_on_the_way_are_those_of_the_rest_of_the_motion(problem):
    found = problem().solve("gauss4", steps=12, tolerance=1e-11)
    k, given = 4, problem()
    names = given.system.coordinates
    state = dict(zip(names, found.q[k], strict=True))
    state |= dict(zip((a.diff() for a in names), found.trajectory.v[k], strict=True))
    rest = dataclasses.replace(given, start=state, duration=given.duration * 8 / 12)
    again = rest.solve("gauss4", steps=8, tolerance=1e-11, guess=found)
    assert again.cost < 0.999 * found.cost
    (by_q, by_p), (q_again, p_again) = found.costates, again.costates
    way = np.ones(len(names))
    if given.system.constraints:  # along the rod
        way = np.array([-found.q[k, 1], found.q[k, 0]])
    scale = abs(q_again[0] @ way)
    assert abs(by_q[k] @ way - q_again[0] @ way) < 1e-7 * scale
    assert np.abs(by_p[k] - p_again[0]).max() < 1e-7 * np.abs(by_p).max()


@pytest.mark.slow
def test_a_body_turns_over_in_the_least_time():
    """Betts' reorientation, 28.63041 s (J. T. Betts, Practical Methods for Optimal Control, 6.8).

    A straight line leads to the turn about one axis alone, from which both sides are quicker.
    """
    torques, inertia = sp.symbols("u1:4", real=True), sp.symbols("J1:4", positive=True)
    body = ss.RigidBody("body", inertia=inertia)
    rates, q = body.angular_velocity, body.coordinates
    system = ss.MechanicalSystem(
        "satellite",
        coordinates=q,
        kinetic=body.kinetic,
        potential=0,
        parameters=dict(zip(inertia, (5621, 4547, 2364), strict=True)),
        constraints=body.constraints,
        forces={
            a: sum(M * w.diff(a.diff()) for M, w in zip(torques, rates, strict=True)) for a in q
        },
        inputs=torques,
    )
    rest, turned = {a.diff(): 0 for a in q}, sp.rad(75)
    problem = ss.OptimalControl(
        system,
        final_cost=ss.time,
        start={**dict(zip(q, (1, 0, 0, 0), strict=True)), **rest},
        end={**dict(zip(q, (sp.cos(turned), sp.sin(turned), 0, 0), strict=True)), **rest},
        duration=(10, 60),
        bounds=dict.fromkeys(torques, (-50, 50)),
    )
    own = {torques[0]: (-50, 50), torques[1]: 0, torques[2]: 0}
    about_one = dataclasses.replace(problem, bounds=own).solve("lobatto6", steps=20)
    assert abs(about_one.duration - 2 * np.sqrt(np.radians(150) * 5621 / 50)) < 1e-3
    assert abs(problem.solve("lobatto6", steps=20).duration - 29.42) < 1e-2  # another optimum
    aside = {q[2]: lambda t: 0.3 * np.sin(np.pi * t / 30), "duration": 30}
    first = problem.solve("lobatto6", steps=20, guess=aside)
    found = problem.solve("lobatto6", steps=80, guess=first)
    assert abs(found.duration - 28.63041) < 5e-4
    arcs = first.arcs()
    assert [len(arc) for arc in arcs] == [3] * 6
    exact = dataclasses.replace(problem, phases=arcs).solve("lobatto6", steps=24, guess=first)
    assert abs(exact.duration - 28.6304065) < 2e-7
    assert np.abs(found.trajectory.constraint_error).max() < 1e-12


def rows_of_the_rod(found):
    names = found.layout.names
    ends = ("", " at the start", " at the end")
    return [names.count(f"constraint 'rod'{end}") for end in ends]


def test_ends_that_repeat_or_contradict_constraints():
    """What conditions imply is no row of its own; what they contradict is refused."""
    again = {q: q for q in (x, y, x.diff(), y.diff())}
    round_ = ss.OptimalControl(
        PLANE, cost=(u - 1) ** 2, conditions=again, duration=2.0, start={x: (0.2, 0.6)}
    )
    found = round_.solve("simpson", steps=20)
    assert found.success, found.message
    # at the start phi and its rate, at control points phi, but not at the last one
    assert rows_of_the_rod(found) == [39, 2, 0]
    assert rows_of_the_rod(swing().solve("simpson", steps=20)) == [39, 0, 0]
    assert rows_of_the_rod(swing(start=(0, 0), end=(0.1, 0)).solve("simpson", steps=2)) == [3, 0, 0]
    assert np.abs(found.q[-1] - found.q[0]).max() < 1e-9
    assert abs(np.hypot(*found.q[0]) - LENGTH) < 1e-9
    for end, wrong in (("start", {x: 0.5, y: 0.5}), ("end", {**bob(2.0, 0.0), x.diff(): 0.3})):
        with pytest.raises(ss.InputError, match=f"{end} contradicts the constraint 'rod'"):
            ss.OptimalControl(PLANE, cost=u**2, duration=1.0, **{end: wrong}).solve(steps=4)
    sideways = {**dict.fromkeys((x, y, th), 0), x.diff(): 0, y.diff(): 1, th.diff(): 0}
    with pytest.raises(ss.InputError, match="start contradicts the constraint 'blade'"):
        ss.OptimalControl(SLEIGH, cost=f**2, duration=1.0, start=sideways).solve(steps=4)


def test_gains_and_a_finer_run_know_the_constraint():
    found = swing().solve("simpson", steps=20)
    run, off = found.simulate(refine=5)
    assert off < 1e-3
    assert np.abs(run.constraint_error).max() < 1e-12
    gains = found.lqr(np.eye(4), np.eye(1))
    assert gains.shape == (20, 1, 4)
    assert np.isfinite(gains).all()


def test_a_guess_is_put_on_the_constraints():
    aside = {x: lambda t: 3 + 0 * t, y: lambda t: 4 + 0 * t}
    found = ss.OptimalControl(PLANE, cost=u**2, duration=1.0).solve(
        "simpson", steps=50, guess=aside, most_iterations=0
    )
    assert np.abs(found.q - [0.6 * LENGTH, 0.8 * LENGTH]).max() < 1e-9


def test_paths_that_jump_between_control_points_are_no_solutions(monkeypatch):
    """A straight line from below leads through the axis, where the rod determines nothing."""
    up = swing(start=(0, 0), end=(np.pi, 0), duration=1.0)
    monkeypatch.setattr(
        solution, "curve_guess", lambda layout, x: []
    )  # as if there were no way aside
    right = swing(plane=False, start=(0, 0), end=(np.pi, 0), duration=1.0)
    least = right.solve("gauss6", steps=40).cost
    for scheme, steps in (("gauss6", 12), ("simpson", 12), ("simpson", 41)):
        begun = up.solve(scheme, steps=steps, most_iterations=0)
        assert not follows_constraints(begun.layout, begun.x)
        found = up.solve(scheme, steps=steps)
        if found.status is ss.ControlStatus.NOT_RESOLVED:
            assert "jumps to another branch" in found.message
        elif found.success:  # many ways lead to such paths, and not all of them end
            assert found.cost == pytest.approx(least, rel=2e-3)
    way = {x: lambda t: LENGTH * np.sin(np.pi * t), y: lambda t: -LENGTH * np.cos(np.pi * t)}
    found = up.solve("gauss6", steps=12, guess=way)
    assert found.success
    assert abs(found.cost / least - 1) < 1e-3


@pytest.mark.parametrize(
    ("metre", "second", "kg"), [(1, 1, 1), (1e-9, 1, 1), (1e9, 1e7, 1e24), (1, 1e-12, 1e-27)]
)
def test_a_guess_over_a_point_without_slope_is_moved_aside(metre, second, kg):
    """Swing-up of a bob whose straight guess goes through the axis of the rod."""
    bob = ss.MechanicalSystem(
        "bob",
        coordinates=(x, y),
        kinetic=kg * (x.diff() ** 2 + y.diff() ** 2) / 2,
        potential=kg * 9.81 * metre / second**2 * y,
        constraints={"rod": (x**2 + y**2 - metre**2) / 2},
        forces={x: -u * y / metre**2, y: u * x / metre**2},
        inputs=(u,),
    )
    rest = {x.diff(): 0, y.diff(): 0}
    found = ss.OptimalControl(
        bob,
        cost=u**2,
        start={x: 0, y: -metre, **rest},
        end={x: 0, y: metre, **rest},
        duration=2 * second,
    ).solve("lobatto6", steps=20)
    assert found.success, found.message
    # Pontryagin's equations by the angle: a local optimum has 68.131, this one less
    unit = (kg * metre**2 / second**2) ** 2 * second
    assert found.cost / unit == pytest.approx(65.4769, rel=1e-4)


def test_an_iterate_without_slopes_has_momenta_all_the_same():
    up = swing(start=(0, 0), end=(np.pi, 0), duration=1.0)
    found = up.solve("lobatto6", steps=20, most_iterations=0)
    assert np.isfinite(found.p).all()
    assert len(found.trajectory.t) == 21
