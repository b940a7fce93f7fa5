"""What the environment says of progress bars and of Ctrl-C is no matter of the tests.

They make hundreds of steppers for a run each: what it does not need is not compiled.
"""

import os
import signal

import pytest
from support.cases import drawn, seed_of_the_run

os.environ["SYMSIMPSON_COMPILE"] = "late"
os.environ.pop("TQDM_DISABLE", None)  # read when tqdm is imported
# where a script starts the tests in its background, Ctrl-C is ignored
signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_addoption(parser):
    group = parser.getgroup("cases")
    group.addoption("--seed", type=int, help="draws the slow cases (default: today's date)")
    group.addoption("--cases", choices=("drawn", "every"), default="drawn")


def pytest_configure(config):
    seed_of_the_run(config)  # before other processes begin


@pytest.hookimpl(tryfirst=True)  # what is fast counts as seen, whether it is run or not
def pytest_collection_modifyitems(config, items):
    by_name = any("[" in one for one in config.args)
    if config.getoption("cases") == "drawn" and not by_name:
        items[:], waiting = drawn(items, seed_of_the_run(config))
        config.hook.pytest_deselected(items=waiting)


def pytest_terminal_summary(terminalreporter, config):
    if config.getoption("cases") == "drawn":
        terminalreporter.write_line(f"Cases were drawn with --seed {seed_of_the_run(config)}.")
