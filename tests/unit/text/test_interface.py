"""What generated modules and their driver agree on, and what becomes of a module that does not."""

import ast
import re

import pytest

import symsimpson as ss
from symsimpson.errors import StaleKernelError
from symsimpson.lower.pipeline import source
from symsimpson.program.driver import driver_text
from symsimpson.text import interface
from symsimpson.text.header import SIGNED, digest, read_header, with_facts
from symsimpson.text.syntax import redefined
from symsimpson.text.table import TABLE
from symsimpson.text.workspace_layout import BLOCKS, DRIVER_LAYOUT, by_name

TEXT = source(ss.systems.pendulum(), "midpoint")
DRIVEN = source(ss.systems.driven_cart_pole(), "midpoint")


def signed(text):
    banner = SIGNED.search(text)
    return text.replace(banner[1], digest(text[banner.end() :]), 1)


@pytest.mark.parametrize("text", [TEXT, DRIVEN])
def test_the_driver_is_told_where_blocks_stand(text):
    header = read_header(text, "here")
    places_of = dict(zip(DRIVER_LAYOUT, header.driver_layout.tolist(), strict=True))
    for name in DRIVER_LAYOUT.keys() & BLOCKS.keys() & header.layout.keys():
        assert places_of[name] == header.layout[name]
    behind_all_others = [places_of[name] for name in ("TANGENT", "GROWN", "ROWS")]
    assert behind_all_others == [header.rows] * 3
    assert places_of["STATE_END"] == header.layout["PREDICTED"]
    assert places_of["MEASURED"] == header.layout["PREDICTED"] - header.layout["INCREMENT"]
    assert (places_of["INPUT_STRIDE"] > 0) == (text == DRIVEN)


def test_the_driver_knows_the_places_of_what_it_is_told_by_name():
    places = {name: getattr(interface, name) for name in DRIVER_LAYOUT}
    assert places.items() <= interface.constants().items()
    assert sorted(places.values()) == list(range(len(DRIVER_LAYOUT)))


def test_blocks_stand_behind_one_another():
    layout = read_header(DRIVEN, "here").layout
    rows = [layout[name] for name in BLOCKS if name in layout]
    assert rows == sorted(rows)
    assert rows[-1] <= layout["ROWS"]


def test_each_block_has_a_name_of_its_own():
    with pytest.raises(ValueError, match="have the same name"):
        by_name([*TABLE, TABLE[0]])


def test_rows_of_velocity_constraints_are_found_in_older_modules():
    text = source(ss.systems.rolling_disc(), "midpoint")
    older = redefined(re.sub(r"\bSLIP", "RATE", text), {"INTERFACE": "INTERFACE = 13"})
    layout, now = (read_header(x, "here").layout for x in (signed(older), text))
    assert layout["SLIP"] == layout["RATE"] == now["SLIP"]
    assert "RATE" not in now


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
    with pytest.raises(StaleKernelError, match="do not follow one another"):
        read_header(signed(changed), "here")


def test_the_driver_is_one_text_that_imports_nothing_of_ours():
    tree = ast.parse(driver_text(8))
    imported = {node.module for node in tree.body if isinstance(node, ast.ImportFrom)}
    assert not any(name.startswith("symsimpson") for name in imported)
    assert len(re.findall(r"^LANES = 8$", driver_text(8), re.MULTILINE)) == 1


def test_a_module_of_the_interface_before_is_refused_and_told_what_to_do():
    with pytest.raises(StaleKernelError, match=r"has kernel interface 9.*\n.*Generate it again"):
        read_header(signed(redefined(TEXT, {"INTERFACE": "INTERFACE = 9", "FACTS": ""})), "here")


@pytest.mark.parametrize(
    "facts",
    [
        {"order": "two"},
        {"colour": 1},
        {"coordinates": "theta"},
        {"coordinates": (1,)},
        {"coordinates": ("theta", "phi")},
        {"coordinates": None},
        {"defaults": (1.0,)},
        {"signs": ()},
        {"signs": ("odd", "", "")},
        {"order": -3},
        {"retimed": True},
        {"constraints": ("rod",)},
        {"inputs": ("u",), "input_places": ("nonsense",)},
        {"parameters": ("m", "m", "g")},
        {"layout": {}},
    ],
)
def test_facts_of_other_kinds_are_refused(facts):
    with pytest.raises(StaleKernelError, match="of other types"):
        read_header(signed(with_facts(TEXT, facts)), "here")


def test_a_module_without_sizes_is_refused():
    with pytest.raises(StaleKernelError, match="not complete"):
        read_header(signed(redefined(TEXT, {"DEGREE": ""})), "here")


@pytest.mark.parametrize("said", ["", "FACTS = {[1]: 2}", 'FACTS = {"order": inf}', "FACTS = 3"])
def test_a_module_without_facts_is_refused(said):
    with pytest.raises(StaleKernelError, match="not complete, or of other types"):
        read_header(signed(redefined(TEXT, {"FACTS": said})), "here")
