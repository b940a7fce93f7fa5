"""Where a test stands says how it is run: with a compiler, or with kernels in plain Python.

The environment is no matter of the tests: what it says of progress bars and of Ctrl-C. What a
stepper does not need is not compiled.
"""

# ruff: noqa: E402
import os
import signal
import sys

# what one process has read of Python, others need not translate again
sys.dont_write_bytecode = False
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)

import pytest
from support.cases import drawn, seed_of_the_run
from support.places import TESTS
from support.plain import plain

os.environ["SYMSIMPSON_COMPILE"] = "late"
os.environ.pop("TQDM_DISABLE", None)  # read when tqdm is imported
# where a script starts the tests in its background, Ctrl-C is ignored
signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_addoption(parser):
    group = parser.getgroup("cases")
    group.addoption("--seed", type=int, help="draws the slow cases (default: today's date)")
    group.addoption("--cases", choices=("drawn", "every"), default="drawn")
    group.addoption("--plain", action="store_true", help="compile nothing for slow tests, either")


def pytest_configure(config):
    seed_of_the_run(config)  # before other processes begin


def pytest_ignore_collect(collection_path, config):
    """Leave out pages where no slow test is asked for: they all are, and take long to read."""
    if config.option.markexpr == "not slow" and collection_path == TESTS / "pages":
        return True


@pytest.hookimpl(tryfirst=True)  # what is fast counts as seen, whether it is run or not
def pytest_collection_modifyitems(config, items):
    for item in items:
        if TESTS / "pages" in item.path.parents:
            item.add_marker("slow")
    by_name = any("[" in one for one in config.args)
    if config.getoption("cases") == "drawn" and not by_name:
        items[:], waiting = drawn(items, seed_of_the_run(config))
        config.hook.pytest_deselected(items=waiting)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item, nextitem):
    """Let nothing be compiled for a test, unless it is slow or stands in tests/compiled.

    Those are plain that take a few steps of a large system: compiling it takes longer.
    """
    slow = item.get_closest_marker("slow") and not item.get_closest_marker("plain")
    slow = slow and not item.config.option.plain
    if slow or TESTS / "compiled" in item.path.parents:
        return (yield)
    with pytest.MonkeyPatch.context() as patch, plain(patch):
        return (yield)


def pytest_terminal_summary(terminalreporter, config):
    if config.getoption("cases") == "drawn":
        terminalreporter.write_line(f"Cases were drawn with --seed {seed_of_the_run(config)}.")
