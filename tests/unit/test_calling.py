"""Calls of a user with arguments that there are not, and where warnings belong."""

import inspect
import warnings

import pytest
import sympy as sp

import symsimpson as ss
from symsimpson.support.calling import explain_arguments, warn

(x,) = ss.coordinates("x")
T, V = x.diff() ** 2 / 2, x**2 / 2
START = {"q0": [1.0], "v0": [0.0]}


@pytest.fixture(scope="module")
def stepper():
    return ss.compile(ss.systems.pendulum())


WRONG = {
    "dt": (lambda s: s.integrate(**START, dt=0.1, steps=2), "has no argument dt=. Did you mean h="),
    "t_eval": (
        lambda s: s.ensemble(**START, h=0.1, t_eval=[1]),
        "mean every=.*The step size is h=",
    ),
    "parameter": (lambda s: s.integrate(**START, h=0.1, steps=1, parameter={}), "parameters="),
    "positional": (
        lambda s: s.integrate([1.0], [0.0], 0.1, 3),
        "at most 2 positional arguments: q0, v0.\nPass the others by name",
    ),
    "ensemble": (lambda s: s.ensemble([[1.0]], v0=[0.0], dt=0.1, steps=1), "mean h="),
    "step": (lambda s: s.step([1.0], v0=[0.0], h=0.1), "no argument v0=. Did you mean v="),
    "start": (lambda s: s.start([1.0], v0=[0.0], dt=0.1), "mean h="),
    "poincare": (lambda s: s.poincare("theta", **START, h=0.1, tf=1), "mean t_end="),
    "gradient": (lambda s: s.gradient(**START, h=0.1, steps=1, costs="theta", wrt="q"), "cost="),
    "certify": (lambda s: s.certify(dt=0.1), "mean h="),
    "choose": (lambda s: ss.choose(ss.systems.pendulum(), **START, t_end=1, tol=1), "mean error="),
    "missing": (
        lambda s: s.integrate([1.0], v0=[0.0], steps=3),
        "is missing h=, the step size\\. Pass it, .*\nIt takes q0=",
    ),
    "missing two": (lambda s: s.gradient([1.0], v0=[0.0], steps=3), "is missing h=, wrt=."),
    "compile": (lambda s: ss.compile(ss.systems.pendulum(), method="simpson"), "mean scheme="),
    "events": (lambda s: s.integrate(**START, h=0.1, steps=1).events("theta", wraps=1), "wrap="),
}


@pytest.mark.parametrize("name", WRONG)
def test_arguments_that_there_are_not(stepper, name):
    call, message = WRONG[name]
    with pytest.raises(ss.InputError, match=f"(?s){message}"):
        call(stepper)


def test_declarations_name_their_keywords():
    with pytest.raises(
        ss.ModelError,
        match=r"at most 1 positional argument: name.\nPass the others by name: .*kinetic=",
    ):
        ss.MechanicalSystem("p", (x,), T, V)
    with pytest.raises(ss.ModelError, match=r"no argument potental=. Did you mean potential="):
        ss.MechanicalSystem("p", coordinates=(x,), kinetic=T, potental=V)
    with pytest.raises(
        ss.ModelError, match=r"from_lagrangian has no argument params=.*parameters="
    ):
        ss.MechanicalSystem.from_lagrangian("p", T - V, (x,), params={})


def test_the_catalogue_says_how_parameters_are_given():
    for call in (lambda: ss.systems.double_pendulum(l1=0.3), lambda: ss.systems.kepler(0.3)):
        with pytest.raises(
            ss.ModelError, match=r"Pass values of parameters to runs: .*parameters={'g': 1.62}"
        ):
            call()
    with pytest.raises(ss.ModelError, match="whole number of links, not 0"):
        ss.systems.n_pendulum(0.3)  # its own error
    assert ss.systems.n_pendulum(n=2).n == 2
    assert ss.systems.EVERY["kepler"] is ss.systems.kepler is ss.systems.CATALOGUE["kepler"]


def test_a_step_names_its_own_arguments(stepper):
    for call in (stepper.step, stepper.tangent):
        with pytest.raises(ss.InputError, match="exactly one of v and p, but has neither"):
            call([1.0], h=0.1)
        with pytest.raises(ss.InputError, match="exactly one of v and p, but has both"):
            call([1.0], [0.0], p=[0.0], h=0.1)


def test_what_goes_with_a_file_needs_one(stepper):
    with pytest.raises(ss.InputError, match=r"Pass checkpoint='run.ckpt' as well"):
        stepper.integrate(**START, h=0.1, steps=2, checkpoint_every=3)


def test_names_of_the_package_that_there_are_not_have_neighbours():
    with pytest.raises(AttributeError, match=r"has no MechanicalSystm. Did you mean Mechanical"):
        ss.MechanicalSystm  # noqa: B018


def test_functions_without_arguments_and_methods_of_parents(stepper):
    for call, message in (
        (lambda: stepper.report(x=3), r"Stepper.report has no argument x=.\nIt takes none."),
        (lambda: stepper.report(3), r"Stepper.report got 1 .*takes none.\nCall .*: report\(\)"),
        (lambda: stepper.integrate(**START, h=0.1, steps=2).plot(xs=1), "Trajectory.plot has no"),
    ):
        with pytest.raises(ss.InputError, match=message):
            call()


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: ss.coordinates("q", real=True), "such as real=True.*Remove the assumptions"),
        (lambda: ss.coordinates(), "coordinates is missing names=.\nIt takes names=."),
        (lambda: ss.momenta(x=x), "momenta has no argument x="),
        (lambda: ss.MechanicalSystem("p", coordinates=(x,), T=T, V=V), "T=. Did you mean kinetic="),
        (lambda: ss.MechanicalSystem("p", coordinates=(x,), kinetic=T, U=V), "mean potential="),
    ],
)
def test_declarations_know_what_was_meant(call, message):
    with pytest.raises(ss.ModelError, match=f"(?s){message}"):
        call()


def test_what_python_says_well_is_left_to_it(stepper):
    with pytest.raises(TypeError, match="multiple values for argument 'q0'"):
        stepper.integrate([1.0], q0=[1.0], v0=[0.0], h=0.1, steps=3)


def test_an_error_from_within_is_left_as_it_is():
    @explain_arguments()
    def broken(a):
        return a + "text"

    with pytest.raises(TypeError, match="unsupported operand"):
        broken(1)


def test_signatures_stay(stepper):
    assert list(inspect.signature(stepper.integrate).parameters)[:3] == ["q0", "v0", "p0"]
    assert stepper.integrate.__doc__.startswith("Integrate the equations")
    assert inspect.signature(ss.MechanicalSystem).parameters["kinetic"].kind.name == "KEYWORD_ONLY"


def test_warnings_belong_to_the_line_that_calls():
    k = sp.Symbol("k")
    idle = ss.compile(
        ss.MechanicalSystem("idle", coordinates=(x,), kinetic=T, potential=V, parameters={k: 1.0})
    )
    idle.integrate(**START, h=0.1, steps=2, parameters={k: 1.0})  # its default
    line = inspect.currentframe().f_lineno + 2
    with pytest.warns(ss.ModelWarning, match="idle: k stands in no expression") as told:
        idle.integrate(**START, h=0.1, steps=2, parameters={"k": 5})
    assert [(one.filename, one.lineno) for one in told] == [(__file__, line)]
    with pytest.warns(ss.ModelWarning, match="k stands in no expression"):
        idle.ensemble([1.0], v0=[0.0], h=0.1, steps=2, parameters={k: [1.0, 2.0]})
    wall = ss.Event(x - k, name="wall", action=ss.Impact())
    idle.integrate(**START, h=0.1, steps=2, parameters={k: -4.0}, events=[wall])  # it stands there
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        warn("of nobody's call", UserWarning)
    assert told[0].filename == __file__


def test_idle_parameters_are_told_by_names_and_not_by_letters():
    for name in "neo":
        own = sp.Symbol(name)
        idle = ss.compile(
            ss.MechanicalSystem(
                "idle", coordinates=(x,), kinetic=T, potential=V, parameters={own: 1.0}
            )
        )
        with pytest.warns(ss.ModelWarning, match=f"{name} stands in no expression"):
            idle.integrate(**START, h=0.1, steps=2, parameters={own: 5})


def test_parameters_of_positions_alone_are_no_idle_ones():
    l = sp.Symbol("l")
    system = ss.MechanicalSystem(
        "drawn",
        coordinates=(x,),
        kinetic=T,
        potential=V,
        parameters={l: 1.0},
        positions={"bob": (l * sp.sin(x),), "body": [(0, l), (1, x), (0, 0)]},
    )
    assert not ss.compile(system).program.names.idle
