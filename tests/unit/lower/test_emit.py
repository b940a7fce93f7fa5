"""How emitted lines look."""

import symsimpson as ss
from symsimpson.lower.emit import WIDTH, _statements
from symsimpson.lower.expression import Expressions
from symsimpson.lower.ir import Load, Row, Store
from symsimpson.lower.pipeline import source
from symsimpson.lower.printer import Printer

NAMES = Expressions()


def load(name, block, index):
    return Load(NAMES.make_symbol(name), Row(block, index))


def test_loads_of_one_block_share_lines():
    loads = [load(f"x{k}", "POSITION", k) for k in range(4)]
    loads += [load("p", "MOMENTUM", 0), load("far", "POSITION", 9)]
    assert _statements(loads, Printer(), 1) == [
        "    x0, x1, x2 = W[POSITION, lane], W[POSITION + 1, lane], W[POSITION + 2, lane]",
        "    x3 = W[POSITION + 3, lane]",
        "    p = W[MOMENTUM, lane]",
        "    far = W[POSITION + 9, lane]",
    ]


def test_results_of_one_block_share_lines_and_what_is_computed_stands_alone():
    a, b = NAMES.make_symbol("a"), NAMES.make_symbol("b")
    values = [a, b, -a, a + b]
    stores = [Store(Row("POSITION", k), value) for k, value in enumerate(values)]
    stores += [Store(Row("MOMENTUM", 0), a), Store(Row("MOMENTUM", 1), b, add=True)]
    assert _statements(stores, Printer(), 1) == [
        "    W[POSITION, lane], W[POSITION + 1, lane], W[POSITION + 2, lane] = a, b, -a",
        "    W[POSITION + 3, lane] = a + b",
        "    W[MOMENTUM, lane] = a",
        "    W[MOMENTUM + 1, lane] += b",
    ]


def test_long_names_stand_alone():
    loads = [load(f"a_long_name_of_a_coordinate_{k}", "NODE_POSITION", k) for k in range(4)]
    lines = _statements(loads, Printer(), 2)
    assert len(lines) == 4
    assert max(map(len, lines)) <= WIDTH


def test_a_text_begins_with_the_step_then_come_the_system_and_what_all_modules_share():
    text = source(ss.systems.double_pendulum(), "simpson")
    names = ("newton", "step_equations", "sincos", "solve_pivoted")
    places = [text.index(f"\ndef {name}(") for name in names]
    assert places == sorted(places)
