"""Which cases of a test are run: one of each kind, and others by a seed that changes every day.

Products of systems and schemes, and campaigns over random systems, have thousands of cases. Each
day some of them are drawn, so that all have their turn: of a product two, with those of the fast
line, and one that is slow at least; of a campaign as many as make thirty systems. Of pages and
notebooks none is left out. The seed stands at the end of the report; ``--seed`` asks for it again,
``--cases every`` for all cases.
"""

import os
import random
from collections import defaultdict
from datetime import UTC, datetime

import pytest

from support.places import TESTS

#: Cases of a product, and random systems that a campaign looks at in one run of the tests.
CASES_A_DAY, SYSTEMS_A_DAY = 2, 30
#: So many numbers are a campaign, fewer are values that somebody chose.
CAMPAIGN = 8
SEED = "SYMSIMPSON_TEST_SEED"


def sweep(values, fast=1):
    """Parameters of a test: the first ones for the fast line, all others for the slow part."""
    values = list(values)
    return [
        *values[:fast],
        *(
            pytest.param(*(x if isinstance(x, tuple) else (x,)), marks=pytest.mark.slow)
            for x in values[fast:]
        ),
    ]


def seed_of_the_run(config):
    """Return what cases are drawn with: the day, where no seed is asked for.

    It goes on to the other processes of the run by the environment.
    """
    given = config.getoption("seed")
    today = int(datetime.now(UTC).strftime("%Y%m%d"))
    return int(os.environ.setdefault(SEED, str(today if given is None else given)))


def drawn(items, seed):
    """Return the cases to be run, in their order, and those that have to wait for their day."""
    functions = defaultdict(list)
    for item in items:
        functions[item.nodeid.split("[")[0]].append(item)
    kept = set()
    for name, cases in functions.items():
        optional = [x for x in cases if hasattr(x, "callspec") and x.get_closest_marker("slow")]
        always = [x for x in cases if x not in optional]
        random.Random(f"{seed} {name}").shuffle(optional)
        whole = TESTS / "pages" in cases[0].path.parents
        places = len(cases) if whole else max(1, _places(cases) - len(always))
        kept.update(always, _covering(always, optional, places))
    return [x for x in items if x in kept], [x for x in items if x not in kept]


def _covering(always, optional, places):
    """Give some cases, such that each value of each parameter is among all that are run."""
    seen = {value for case in always for value in _values(case)}
    for case in optional:
        if places and not seen.issuperset(_values(case)):
            seen.update(_values(case))
            places -= 1
            yield case


def _values(case):
    """Give what a case has of each parametrization; names that are listed together are one."""
    for mark in case.iter_markers("parametrize"):
        names = mark.args[0].split(",") if isinstance(mark.args[0], str) else mark.args[0]
        yield tuple((name.strip(), id(case.callspec.params[name.strip()])) for name in names)


def _places(cases):
    """Return how many cases may be run."""
    numbers = [[*case.callspec.params.values()] for case in cases if hasattr(case, "callspec")]
    if len(cases) <= CAMPAIGN or any(len(x) > 1 or type(x[0]) is not int for x in numbers):
        return CASES_A_DAY
    each = numbers[1][0] - numbers[0][0]  # systems in one case
    return max(1, SYSTEMS_A_DAY // max(1, each))
