"""Arguments of runs are the same in signatures, in types of options, and in requests."""

import inspect
from typing import get_type_hints

import pytest

import symsimpson as ss
from symsimpson.stepping.request import Request, RunOptions, SavedOptions, TimesOptions

KINDS = (RunOptions, TimesOptions, SavedOptions)
#: Arguments that say how a call behaves, and not what is computed.
OF_A_CALL = {"checkpoint_every", "progress", "on_failure"}


def arguments(function):
    return {name: x for name, x in inspect.signature(function).parameters.items() if name != "self"}


def test_integrate_has_the_options_of_its_kinds_and_no_others():
    named = {x for kind in KINDS for x in get_type_hints(kind)}
    assert named == arguments(ss.Stepper.integrate).keys() - {"q0", "v0"}


@pytest.mark.parametrize("method", ["integrate", "ensemble"])
def test_a_request_has_the_arguments_and_defaults_of_a_method(method):
    given = arguments(getattr(ss.Stepper, method))
    assert given.keys() - Request._fields <= OF_A_CALL | {"store", "threads", "client"}
    defaults = {x: p.default for x, p in given.items() if p.default is not p.empty}
    for name in defaults.keys() & Request._field_defaults.keys() - {"every"}:
        assert defaults[name] == Request._field_defaults[name]
