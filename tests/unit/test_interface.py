"""What generated modules and their driver agree on, and what becomes of a module that does not."""

import ast
import re

import pytest

import symsimpson as ss
from symsimpson.codegen.pipeline import source
from symsimpson.errors import StaleKernelError
from symsimpson.module import interface
from symsimpson.module.definitions import redefined
from symsimpson.runtime.driver.compiled import driver_text
from symsimpson.runtime.kernels.header import SIGNED, digest, read_header

TEXT = source(ss.systems.pendulum(), "midpoint")
DRIVEN = source(ss.systems.driven_cart_pole(), "midpoint")


def signed(text):
    banner = SIGNED.search(text)
    return text.replace(banner[1], digest(text[banner.end() :]), 1)


@pytest.mark.parametrize("text", [TEXT, DRIVEN])
def test_names_and_places_of_what_the_driver_is_told_agree(text):
    assert [getattr(interface, name) for name in interface.TOLD] == list(range(len(interface.TOLD)))
    told, layout = read_header(text, "here").told, read_header(text, "here").layout
    none = {} if text == DRIVEN else {"INPUT": 0, "INPUT_STRIDE": 0}
    for name in set(interface.TOLD) - {
        "STATE_END",
        "DIMENSION",
        "MEASURED",
        "STEPS_A_CALL",
        "TANGENT",
        "KEPT",
        "RENEWED",
        "RENEWAL",
    }:
        assert told[getattr(interface, name)] == {**none, **layout}[name]
    assert told[interface.TANGENT] == layout["ROWS"]  # behind all others
    assert told[interface.STATE_END] == layout["PREDICTED"]
    assert told[interface.MEASURED] == layout["PREDICTED"] - layout["INCREMENT"]


def test_sets_of_kernels_have_a_kernel_in_each_place():
    for names in interface.KERNEL_SETS.values():
        assert len(names) == interface.MEASURE
        assert set(names) <= {*interface.KERNELS, ""}


def test_statuses_are_those_of_the_driver():
    for status in ss.Status:
        assert getattr(interface, status.name) == status


@pytest.mark.parametrize(
    ("first", "second"), [("INCREMENT", "PREDICTED"), ("POSITION_LOW", "MOMENTUM")]
)
def test_blocks_that_move_as_one_must_stand_together(first, second):
    """The driver would move the wrong rows without a word."""
    rows = read_header(TEXT, "here").layout
    changed = redefined(
        TEXT, {first: f"{first} = {rows[second]}", second: f"{second} = {rows[first]}"}
    )
    with pytest.raises(StaleKernelError, match="do not stand behind one another"):
        read_header(signed(changed), "here")


def test_the_driver_is_one_text_that_imports_nothing_of_ours():
    tree = ast.parse(driver_text(8))
    imported = {node.module for node in tree.body if isinstance(node, ast.ImportFrom)}
    assert not any(name.startswith("symsimpson") for name in imported)
    assert len(re.findall(r"^LANES = 8$", driver_text(8), re.MULTILINE)) == 1
