"""A table of calls and of the messages that users read: what is wrong, where, why, what to do."""

import numpy as np
import pytest
import sympy as sp
from sympy.physics.units import second

import symsimpson as ss

(x,) = ss.coordinates("x")
k, u = sp.symbols("k u")


def spring(**changes):
    declared = {"coordinates": (x,), "kinetic": x.diff() ** 2 / 2, "potential": x**2 / 2}
    return ss.MechanicalSystem("spring", **declared | changes)


def cart():
    x, y = ss.coordinates("x y")
    return ss.MechanicalSystem("cart", coordinates=(x, y), kinetic=x.diff() ** 2 / 2, potential=x)


def integrate(q0=(1.0,), **arguments):
    return ss.compile(spring()).integrate([*q0], **{"v0": [0.0], "h": 0.1, "steps": 3} | arguments)


def behind_a_wall():
    return integrate([-1.0], events=[ss.Event(x, action=ss.Impact(1))])


DRIVEN = {"forces": {x: u}, "inputs": (u,)}
#: What is called, and what the message says, in this order.
MESSAGES = {
    "assumption": (
        lambda: ss.coordinates("x", positive=True),
        "coordinates accept no assumptions such as positive=True.",
        "Remove the assumptions. Parameters accept them: sympy.symbols('m', positive=True).",
    ),
    "unit": (
        lambda: spring(potential=x * second),
        "system 'spring': the potential contains second, a Quantity.",
        "Write it with symbols, numbers, sums, products, powers and functions.",
    ),
    "no mass": (
        cart,
        "the kinetic energy does not depend on y', so the mass matrix has a zero row.",
        "A variational step needs an invertible mass matrix.",
        "Give y a mass (T += m*y'**2/2), or remove y from the coordinates.",
    ),
    "unknown symbol": (
        lambda: spring(potential=k * x**2),
        "system 'spring': the potential contains the unknown symbol k.",
        "Add a value: parameters={..., k: 1.0}.",
    ),
    "text": (
        lambda: spring(potential="x**2"),
        "system 'spring': the potential is the string 'x**2', not an expression.",
        "Write the SymPy symbols themselves, without quotes.",
    ),
    "jump": (
        lambda: spring(potential=sp.Heaviside(x)),
        "the potential contains Heaviside(x):",
        "the function Heaviside cannot be differentiated twice.",
        "Use a smooth form:",
    ),
    "scheme": (
        lambda: ss.compile(spring(), "simson"),
        "there is no scheme 'simson'. Did you mean simpson?",
        "Choose 'midpoint', 'simpson'",
    ),
    "exploit": (
        lambda: ss.compile(spring(), exploit="cyclc"),
        "exploit contains 'cyclc', which is unknown. Did you mean cyclic?",
        "Choose 'all', ()",
    ),
    "no step size": (
        lambda: ss.compile(spring()).integrate([1.0], v0=[0.0], t_end=1),
        "integrate is missing h=, the step size.",
        "Pass it, or use ss.integrate(system, ..., error=1e-6), which chooses it.",
    ),
    "name of another program": (
        lambda: ss.compile(spring()).integrate([1.0], v0=[0.0], dt=0.1, t_end=1),
        "Stepper.integrate has no argument dt=. Did you mean h=?",
        "The step size is h=; the end is t_end= or steps=",
    ),
    "positional": (
        lambda: ss.compile(spring()).integrate([1.0], [0.0], 0.1),
        "Stepper.integrate got 3 positional arguments, and takes at most 2",
        "Pass the others by name:",
    ),
    "two velocities": (
        lambda: integrate(p0=[0.0]),
        "a run needs exactly one of v0 and p0, but has both.",
        "Pass initial velocities v0=[...] or initial momenta p0=[...].",
    ),
    "shape": (
        lambda: integrate([1.0, 2.0]),
        "q0 has shape (2,), expected (1,): one number for each of x.",
        "Pass the numbers in the order of the declared coordinates, or by name: {'x': ...}.",
    ),
    "not finite": (
        lambda: integrate([np.nan]),
        "q0 is not finite for x: [nan].",
        "Check where this number comes from.",
    ),
    "file format": (
        lambda: integrate().save("run.h5"),
        "unsupported file extension '.h5' of 'run.h5'.",
        "Use .nc (netCDF) or .zarr for a whole run",
    ),
    "quantity": (
        lambda: integrate()["enrgy"],
        "there is no quantity 'enrgy'. Did you mean energy?",
        "The quantities are x, p_x, v_x, t, energy",
    ),
    "event": (
        lambda: integrate(events=[x]),
        "events contains x(t), which is not an Event.",
        "Write symsimpson.Event(x(t), action=...) instead.",
    ),
    "wall": (
        behind_a_wall,
        "spring: the initial state violates the gap 'x(t)', whose value is -1.",
        "Start where the gap is positive, or change the sign of the gap.",
    ),
    "motion to infinity": (
        lambda: ss.compile(spring(potential=-(x**4))).integrate([1.0], v0=[0.0], h=0.01, t_end=2),
        "spring, simpson: step 92 of 200 at t=0.92 with h=0.01 failed.",
        "the motion runs to infinity: look at the sign of the potential.",
        "The states computed so far are in this error's .trajectory.",
    ),
    "no input": (
        lambda: ss.compile(spring(**DRIVEN)).step([1.0], [0.0], h=0.1),
        "spring: the input u has no values.",
        "Pass inputs={'u': values}",
    ),
    "no file": (
        lambda: ss.open_trajectory("nothing.nc"),
        "nothing.nc: there is no such file.",
        "run.save(path) writes one.",
    ),
    "duration": (
        lambda: ss.OptimalControl(
            spring(**DRIVEN), cost=u**2, start={x: 0}, end={x: 1}, duration=-1
        ),
        "duration is -1: it must be above 0.",
        "Pass a positive number, duration=2.0, or bounds of it, duration=(0.5, 4.0).",
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("case", MESSAGES)
def test_a_message_says_what_is_wrong_and_what_to_do(case):
    call, *parts = MESSAGES[case]
    with pytest.raises(ss.SymsimpsonError) as caught:
        call()
    text = str(caught.value)
    places = [text.find(part) for part in parts]
    assert -1 not in places, text
    assert places == sorted(places), text


@pytest.mark.slow
def test_a_warning_says_what_to_do():
    system = spring(potential=x**2 / 2, parameters={k: 1.0})
    with pytest.warns(ss.ModelWarning) as caught:
        ss.compile(system).integrate([1.0], v0=[0.0], h=0.1, steps=3, parameters={"k": 2.0})
    assert "k" in str(caught[0].message)
