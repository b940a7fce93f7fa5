"""The choice of the next mode, at states whose equations are known by hand."""

import numpy as np
import pytest

from symsimpson.run.decide import StateOfContacts
from symsimpson.support.contact_values import Counts, IndexOne, Mode


def block(force, *, v=0.0, limit=1.0, static=1.0, weight=10.0, left=()):
    """A block on a floor, with friction at the contact; positions (x, y), y is the gap."""
    at = IndexOne(
        M=np.eye(2),
        W=np.array([[0.0, 1.0], [1.0, 0.0]]),
        push=np.array([force, -weight]),
        curve=np.zeros(2),
        rates=np.array([0.0, v]),
        gaps=np.zeros(1),
        limits=np.array([limit, static]) / 10,
        momenta=np.zeros(2),
    )
    counts = Counts(0, 1, 0, 1)
    return StateOfContacts(at, counts, (0,), np.zeros(2), np.array([v, 0.0]), 0.1, frozenset(left))


@pytest.mark.parametrize(
    ("state", "first", "mode"),
    [
        (block(0.5), 0, 0),
        (block(1.5), 0, 1),
        (block(-1.5), 0, -1),
        (block(0.5, v=1.0), 1, 1),
        (block(0.5, v=-1.0), -1, -1),
        (block(1.2, static=1.5), 0, 0),  # a sticking element continues to stick
        (block(1.2, static=1.5), 1, 1),
    ],
)
def test_sticking_and_sliding(state, first, mode):
    found, more = state.decide(Mode((True,), (first,)))
    assert (found, more) == (Mode((True,), (mode,)), False)


def test_a_contact_that_pulls_opens():
    state = block(0.0, weight=-1.0)
    assert state.decide(Mode((True,), (0,)))[0] == Mode((False,), (None,))


def test_what_has_left_its_bound_does_not_return():
    state = block(1.0, left={(False, 0)})
    assert state.decide(Mode((True,), (1,)))[0] == Mode((True,), (1,))
    assert block(1.0).decide(Mode((True,), (0,)))[0] == Mode((True,), (0,))


def test_forces_and_accelerations():
    motion = block(3.0).motion(Mode((True,), (1,)))
    assert motion.normal == pytest.approx([10.0])
    assert motion.friction == pytest.approx([1.0])
    assert motion.acceleration == pytest.approx([2.0, 0.0])
    assert motion.margin == pytest.approx(1.0)


def test_limits_must_be_real_and_ordered():
    assert block(0.0).bad_limit() is None
    assert block(0.0, limit=-1.0).bad_limit() == 0
    assert block(0.0, limit=np.nan).bad_limit() == 0
    assert block(0.0, limit=1.0, static=0.5).bad_limit() == 0


def legs(count):
    """A table of one coordinate on several equal legs."""
    at = IndexOne(
        M=np.eye(1),
        W=np.ones((count, 1)),
        push=np.array([-10.0]),
        curve=np.zeros(count),
        rates=np.zeros(count),
        gaps=np.zeros(count),
        limits=np.zeros(0),
        momenta=np.zeros(1),
    )
    counts = Counts(0, count, 0, 0)
    return StateOfContacts(at, counts, (), np.zeros(1), np.zeros(1), 0.1)


def test_dependent_contacts_are_left_out():
    table = legs(4)
    found, more = table.decide(Mode((True,) * 4, ()))
    assert sum(found.contacts) == 1
    assert more  # each leg could carry the table
    assert len(table.implied(found)) == 3
    assert table.motion(Mode((True,) * 2 + (False,) * 2, ())) is None


def test_too_many_choices_are_refused():
    assert legs(13).decide(Mode((True,) * 13, ())) == (None, False)


def test_projection_is_the_nearest_in_the_metric_of_m():
    state = block(0.0, v=2.0)
    dq, dv = state.nearest(Mode((True,), (0,)))
    assert dq == pytest.approx([0.0, 0.0])
    assert dv == pytest.approx([-2.0, 0.0])
