"""How many members of an ensemble stand side by side."""

import pytest

from symsimpson.program import configuration


@pytest.mark.parametrize(
    ("rows", "members", "lanes"),
    [(163, 10_000, 16), (163, 1023, 8), (257, 10_000, 8), (256, 1024, 16)],
)
def test_two_registers_of_many_small_members_stand_side_by_side(rows, members, lanes, monkeypatch):
    monkeypatch.setattr(configuration, "lanes_of_machine", lambda: 8)
    monkeypatch.setattr(configuration, "vector_bits", lambda: 512)
    assert configuration.lanes_for(rows, members) == lanes
    monkeypatch.setattr(configuration, "vector_bits", lambda: 256)
    assert configuration.lanes_for(rows, members) == 8
