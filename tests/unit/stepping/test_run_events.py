"""Events are read once, whatever they are."""

import pytest
import sympy as sp
from support.impacts import BALL, floor, z

import symsimpson as ss
from symsimpson.stepping import run_events
from symsimpson.stepping.request import Request


@pytest.fixture
def reads(monkeypatch):
    read, seen = run_events.read_events, []

    def counted(program, given):
        seen.append(given)
        return read(program, given)

    monkeypatch.setattr(run_events, "read_events", counted)
    return seen


def test_equal_events_are_read_once(reads):
    program = ss.compile(BALL).program
    request = Request([1.0], events=[floor()])
    first = run_events.read_run_events(program, request)
    assert run_events.read_run_events(program, request._replace(events=(floor(),))) is first
    assert len(reads) == 1
    other = run_events.read_run_events(program, request._replace(events=[floor(0.5)]))
    assert other.events[0].action.restitution == 0.5
    assert len(reads) == 2


def test_so_many_are_remembered_and_no_more(reads, monkeypatch):
    monkeypatch.setattr(run_events, "MOST_KNOWN", 2)
    program = ss.compile(BALL).program
    for height in (0.1, 0.2, 0.3):
        asked = Request([1.0], events=[ss.Event(z - height, name="half", terminal=True)])
        assert run_events.read_run_events(program, asked).events[0].expression == z - height
        assert len(program.findings.events) <= 2


def test_what_is_wrong_with_them_is_said_once():
    lifted = ss.Event(z + sp.Symbol("unknown"), name="floor", action=ss.Change(positions={z: 1.0}))
    with pytest.raises(ss.SymsimpsonError) as caught:
        ss.compile(BALL).integrate([1.0], v0=[0.0], h=0.1, steps=2, events=[lifted])
    assert caught.value.__context__ is None


def test_changes_are_read_once(reads):
    program = ss.compile(BALL).program
    for height in (1.0, 1.0, 2.0):
        lifted = ss.Event(z, name="floor", action=ss.Change(positions={z: height}))
        run_events.read_run_events(program, Request([1.0], events=[lifted]))
    assert len(reads) == 2


def test_a_change_keeps_what_it_was_given():
    given = {z: 1.0}
    change = ss.Change(positions=given)
    given[z] = 2.0
    assert change == ss.Change(positions={z: 1.0})
    assert hash(change) == hash(ss.Change(positions={z: 1.0}))
