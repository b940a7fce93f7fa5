"""How emitted lines look."""

import symsimpson as ss
from symsimpson.codegen.emit import WIDTH, _loads
from symsimpson.codegen.expression import Expressions
from symsimpson.codegen.ir import Load, Row
from symsimpson.codegen.pipeline import source

NAMES = Expressions()


def load(name, block, index):
    return Load(NAMES.named(name), Row(block, index))


def test_loads_of_one_block_share_lines():
    loads = [load(f"x{k}", "POSITION", k) for k in range(4)]
    loads += [load("p", "MOMENTUM", 0), load("far", "POSITION", 9)]
    assert list(_loads(loads, 1)) == [
        "    x0, x1, x2 = W[POSITION, lane], W[POSITION + 1, lane], W[POSITION + 2, lane]",
        "    x3 = W[POSITION + 3, lane]",
        "    p = W[MOMENTUM, lane]",
        "    far = W[POSITION + 9, lane]",
    ]


def test_long_names_stand_alone():
    loads = [load(f"a_long_name_of_a_coordinate_{k}", "NODE_POSITION", k) for k in range(4)]
    lines = list(_loads(loads, 2))
    assert len(lines) == 4
    assert max(map(len, lines)) <= WIDTH


def test_a_text_begins_with_the_step_then_come_the_system_and_what_all_modules_share():
    text = source(ss.systems.double_pendulum(), "simpson")
    places = [text.index(f"\ndef {name}(") for name in ("newton", "jet", "sincos", "solve_pivoted")]
    assert places == sorted(places)
