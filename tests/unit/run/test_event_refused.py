"""Events that are refused in words, and what does not go with them."""

import numpy as np
import pytest
import sympy as sp
from support.impacts import BALL, drop, floor, g, x, z

import symsimpson as ss


@pytest.mark.parametrize(
    ("make", "told"),
    [
        (lambda: ss.Impact(1.3), "restitution is 1.3"),
        (lambda: ss.Impact(float("nan")), "restitution is nan"),
        (lambda: ss.Change(), "changes nothing"),
        (
            lambda: ss.Change(velocities={x: 1}, momenta={x: 1}),
            "both the velocity and the momentum of x",
        ),
        (lambda: ss.Event(z, direction=2), "direction is 2"),
        (lambda: ss.Event(z, direction=True), "direction is True"),
        (lambda: ss.Event(z, direction=1, action=ss.Impact()), "where the gap falls"),
        (lambda: ss.Event(z, terminal=-1), "terminal is -1"),
        (lambda: ss.Event(z, action="bounce"), "the action of an event is 'bounce'"),
    ],
)
def test_what_no_event_can_be(make, told):
    with pytest.raises(ss.InputError, match=told):
        make()


@pytest.mark.parametrize(
    ("events", "told"),
    [
        ([floor(), floor(0.5)], "two events have the name 'floor'"),
        ([ss.Event(z, name="z", action=ss.Impact())], "the event name 'z' is also a coordinate"),
        ([ss.Event(z * z.diff(), name="w", action=ss.Impact())], "contains the velocity of z"),
        ([ss.Event(ss.time - 1, name="w", action=ss.Impact())], "depends on no coordinate"),
        ([ss.Event(z - sp.Symbol("z") / 2, name="w", action=ss.Impact())], r"the symbol z\."),
        ([ss.Event(z - sp.Symbol("v_z"), name="w", action=ss.Impact())], r"the symbol v_z\."),
        (
            [ss.Event(z + sp.Symbol("t", real=True), name="w", action=ss.Impact())],
            r"the symbol t\.",
        ),
        ([ss.Event(z - z.subs(ss.time, 3), name="w")], r"contains z\(3\), which is not a value"),
        ([ss.Event(z.subs(ss.time, ss.time - 1), name="w", action=ss.Impact())], r"z\(t - 1\)"),
        ([ss.Event("z", name="w", action=ss.Impact())], "is not a SymPy expression"),
        ([ss.Event(sp.Min(z, 1 - z), name="w", action=ss.Impact())], "has a kink"),
        ([ss.Event((1 - z) ** 2, name="w", action=ss.Impact())], "never changes its sign"),
        ([ss.Event(abs(1 - z), name="w", action=ss.Impact())], "never changes its sign"),
        ([ss.Event(sp.sqrt(z**2), name="w", action=ss.Impact())], "never changes its sign"),
        (
            [ss.Event(g - 1, name="w", action=ss.Switch())],
            "'w' contains no coordinate.*never changes",
        ),
        ([ss.Event(z - x, name="w")], "'x'"),
        (
            [ss.Event(sp.Function("f"), name="w")],
            r"event 'w': f is a function without arguments: write f",
        ),
        (
            [ss.Event(z, name="w", when=sp.sin)],
            "condition of the event 'w': sin is a function without arguments",
        ),
        (
            [ss.Event(z, name="w", action=ss.Change(velocities={x: 1}))],
            "contains 'x', which is not",
        ),
        ([ss.Event(z + 2, name="w", when="sqrt(q)", action=ss.Impact())], "'q'"),
        ([floor(sp.Symbol("e"))], "the restitution e contains e"),
        ([floor(1 - z.diff() / 20)], r"the restitution 1 - v_z/20 contains v_z\."),
        ([floor(g / 5)], r"the restitution g/5 is 1.962\.\nIt must be between"),
        ([floor(1 - z * ss.time)], r"contains t, z\."),
        ([ss.Event(z - 2, name="w", action=ss.Impact())], "the initial state violates the gap 'w'"),
        (["floor"], "contains 'floor', which is|events contains 'floor'"),
    ],
)
def test_events_that_do_not_fit(events, told):
    with pytest.raises(ss.InputError, match=told):
        drop(*events)


def test_what_does_not_go_with_events():
    with pytest.raises(ss.InputError, match="cannot be combined with multiprecision"):
        ss.compile(BALL, precision=30).integrate([1.0], v0=[0.0], h=0.01, steps=3, events=[floor()])


@pytest.mark.parametrize(
    ("make", "told"),
    [
        (lambda: ss.Impact("0.8"), "restitution is '0.8'"),
        (lambda: ss.Impact(None), "restitution is None"),
        (lambda: ss.Impact(sp.I), "restitution is I"),
        (lambda: ss.Impact(sp.Matrix([1, 2])), "restitution is Matrix"),
        (lambda: ss.Impact(True), "restitution is True"),
        (lambda: ss.Impact(sp.Function("f")), "restitution is f"),
        (lambda: ss.Impact(sp.sin), "restitution is sin"),
        (lambda: drop(reduce={"a": ("max", [z, z])}), r"reduce\['a'\]: it contains"),
        (
            lambda: drop(reduce={"a": ("max", sp.sin)}),
            r"reduce\['a'\]: sin is a function without arguments",
        ),
        (lambda: drop(reduce={"a": ("max", np.ones(2))}), r"reduce\['a'\]: it is no expression"),
        (lambda: ss.Change(velocities=3), "velocities is 3, not a mapping"),
        (lambda: ss.Event(z, name=3), "the name of an event is 3"),
    ],
)
def test_arguments_of_other_kinds(make, told):
    with pytest.raises((ss.InputError, TypeError), match=told):
        make()


def test_mistakes_in_events_of_ensembles_are_told_before():
    many = ss.compile(BALL).ensemble
    given = {"v0": [0.0], "h": 0.01, "steps": 20}
    with pytest.raises(ss.InputError, match="the restitution e contains e"):
        many([[1.0], [2.0]], events=[floor(sp.Symbol("e"))], **given)
    with pytest.raises(
        ss.InputError, match=r"the growth of variations\. Runs with events do not measure"
    ):
        many([[1.0], [2.0]], events=[floor()], reduce={"l": "lyapunov"}, **given)


def test_names_that_are_none():
    floor = ss.Event(z, name="floor", action=ss.Impact())
    run = ss.compile(BALL).integrate([1.0], v0=[0.0], h=0.05, steps=4, events=[floor])
    with pytest.raises(
        ss.InputError, match=r"no event 'flor'. Did you mean floor\? Its events are f"
    ):
        run.events("flor")
    with pytest.raises(
        ss.InputError, match=r"z\(t\), which is not an Event.\nWrite .*Event\(z\(t\), "
    ):
        ss.compile(BALL).integrate([1.0], v0=[0.0], h=0.05, steps=4, events=[z])


def test_a_constraint_of_a_list_is_called_by_its_number():
    x, y = ss.coordinates("x y")
    bob = ss.MechanicalSystem(
        "bob",
        coordinates=(x, y),
        kinetic=(x.diff() ** 2 + y.diff() ** 2) / 2,
        potential=y,
        constraints=[x**2 + y**2 - 1],
    )
    with pytest.raises(ss.InputError, match="q0 violates the constraint number 1 of the list"):
        ss.compile(bob).integrate([1.0, 1.0], v0=[0.0, 0.0], h=0.1, steps=3)
