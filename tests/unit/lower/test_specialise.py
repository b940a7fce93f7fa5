"""Conditions on facts in texts of the library."""

import pytest

from symsimpson.lower.emit import _statements
from symsimpson.lower.printer import Printer
from symsimpson.lower.specialise import kernel_from_text, specialise

TEXT = '''\
@compiled
def step(W, h, t, lane):
    """Take a step."""
    # first
    if HELD:
        # with constraints
        for c in range(CONSTRAINTS):
            hold(
                W, c, lane
            )
    else:
        free(W, lane)
    if not DRIVEN and VARIED_BY > 1:
        undriven(W, lane)  # no input
    if CARRIED:
        one(W, lane)
    elif W[X, lane] > 0:
        two(W, lane)  # by value
    elif ROLLING:
        three(W, lane)
    else:
        four(W, lane)
    if W[ACTIVE, lane] != 0 and (
        HELD or W[X, lane] > 0
    ):  # long
        five(W, lane)
    for a in range(3):
        if HELD:
            # not without them
            six(W, a, lane)
    return (h if AUTONOMOUS else t) + (
        1 if HELD else 2
    )
'''
FACTS = {"HELD": True, "DRIVEN": False, "VARIED_BY": 2, "CARRIED": False, "ROLLING": True}
FACTS |= {"AUTONOMOUS": True}


def test_one_branch_stays_with_its_comments():
    assert (
        specialise(TEXT, FACTS) + "\n"
        == '''\
@compiled
def step(W, h, t, lane):
    """Take a step."""
    # first
    # with constraints
    for c in range(CONSTRAINTS):
        hold(
            W, c, lane
        )
    undriven(W, lane)  # no input
    if W[X, lane] > 0:
        two(W, lane)  # by value
    else:
        three(W, lane)
    if W[ACTIVE, lane] != 0:
        five(W, lane)
    for a in range(3):
        # not without them
        six(W, a, lane)
    return (h) + (
        1
    )
'''
    )


def test_the_other_branch_and_nothing():
    facts = {**FACTS, "HELD": False, "VARIED_BY": 1, "ROLLING": False}
    assert (
        specialise(TEXT, facts) + "\n"
        == '''\
@compiled
def step(W, h, t, lane):
    """Take a step."""
    # first
    free(W, lane)
    if W[X, lane] > 0:
        two(W, lane)  # by value
    else:
        four(W, lane)
    if W[ACTIVE, lane] != 0 and W[X, lane] > 0:
        five(W, lane)
    return (h) + (
        2
    )
'''
    )


def test_what_has_no_facts_stays_as_it_is():
    text = "def f(n):\n    if n > SIZE and (n or\n            HELD[n]):\n        return n"
    assert specialise(text, FACTS) == text


def test_a_body_without_statements_passes():
    text = (
        "def f(n):\n    if n:\n        if not HELD:\n            g()\n    elif HELD:\n        h()"
    )
    assert specialise(text, {"HELD": True}) == (
        "def f(n):\n    if n:\n        pass\n    else:\n        h()"
    )
    assert specialise("def f():\n    if HELD:\n        g()", {"HELD": False}) == (
        "def f():\n    pass"
    )


def test_a_fact_must_be_known():
    with pytest.raises(KeyError, match="The module has no value of DRIVEN"):
        specialise(TEXT, {"HELD": True, "AUTONOMOUS": True})


def test_a_kernel_is_the_body_of_its_text(monkeypatch):
    sources = {
        "work": '@kernel\ndef work(W, h, t, lane):\n    """Work."""\n    if HELD:\n        g(W)'
    }
    monkeypatch.setattr("symsimpson.lower.specialise.kernel_sources", lambda: sources)
    kernel = kernel_from_text("work", {"HELD": True})
    assert (kernel.name, kernel.doc) == ("work", "Work.")
    assert _statements(kernel.body, Printer(), 1) == [
        "    for lane in range(LANES):",
        "        g(W)",
    ]
