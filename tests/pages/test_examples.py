"""The examples in docstrings of the package do what they show."""

import doctest
import importlib

import pytest
from support.places import PACKAGE

FILES = [path for path in PACKAGE.rglob("*.py") if ">>> " in path.read_text("utf-8")]
MODULES = sorted(".".join(path.relative_to(PACKAGE.parent).with_suffix("").parts) for path in FILES)


#: Examples that need what the quick tests do without.
NEEDED = dict.fromkeys(
    ("symsimpson.study.control.problem", "symsimpson.study.control.result"), "casadi"
) | {"symsimpson.api.frameworks": "torch", "symsimpson.declare.energy_functions": "jax"}


@pytest.mark.parametrize("name", MODULES)
def test_examples(name):
    if name in NEEDED:
        pytest.importorskip(NEEDED[name])
    found = doctest.testmod(importlib.import_module(name))
    assert found.attempted
    assert not found.failed
