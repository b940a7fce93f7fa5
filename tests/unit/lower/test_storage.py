"""Entries of the matrices of large systems: each has a place of its own, and few are left over."""

import pytest

from symsimpson.lower.storage import Storage

STORAGES = [
    Storage.dense(5),
    Storage(tuple(range(9)), 1, banded=True),
    Storage((3, 1, 4, 0, 2, 5, 8, 7, 6, 9, 11, 10), 2, banded=True),
]
NAMES = ["dense", "band 1", "band 2"]


@pytest.mark.parametrize("storage", STORAGES, ids=NAMES)
def test_entries_of_nodes(storage):
    n, band, found = storage.n, storage.band, storage.node_constants()
    pairs = [(a, b) for a in range(n) for b in range(n) if abs(a - b) <= band]
    places = {a * found["NODE_STRIDE"] + b + found["NODE_OFFSET"] for a, b in pairs}
    assert len(places) == len(pairs)
    assert places <= set(range(storage.node_size))
    assert storage.node_size - len(pairs) == (band * (band + 1) if storage.banded else 0)


@pytest.mark.parametrize("blocks", [1, 2, 3])
@pytest.mark.parametrize("storage", STORAGES, ids=NAMES)
def test_entries_of_systems(storage, blocks):
    """A band, with the room that pivoting takes above it."""
    size, band = storage.n * blocks, storage.band
    row, place, stride, offset = storage.constants("S", blocks).values()
    lower, upper = storage.bounds("S", blocks).values()
    unknowns = {s * place + k * row: s for s in range(storage.n) for k in range(blocks)}
    assert sorted(unknowns) == list(range(size))
    meeting = [
        i - j for i, s in unknowns.items() for j, r in unknowns.items() if abs(s - r) <= band
    ]
    assert lower == max(meeting)
    assert upper == (2 * lower if storage.banded else lower)
    pairs = [(i, j) for i in range(size) for j in range(size) if -lower <= j - i <= upper]
    places = {i * stride + j + offset for i, j in pairs}
    assert len(places) == len(pairs)
    assert places <= set(range(storage.size(blocks)))
    left = lower * (lower + 1) + upper * (upper + 1) if storage.banded else 0
    assert storage.size(blocks) - len(pairs) == left // 2
