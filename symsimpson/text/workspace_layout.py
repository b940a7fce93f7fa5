"""Where the blocks of the workspace stand: their layout, and the part that the driver gets."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise

from symsimpson.text.table import TABLE, Block, Sizes


def by_name(table: Sequence[Block]) -> dict[str, Block]:
    """Return blocks by their names; two blocks of one name raise an error."""
    blocks = {block.name: block for block in table}
    if len(blocks) < len(table):
        raise ValueError("two blocks of the workspace have the same name")
    return blocks


BLOCKS = by_name(TABLE)

#: Blocks that must stand right behind one another: the driver moves them as one.
ADJACENT = (
    ("POSITION", "POSITION_LOW", "MOMENTUM", "MOMENTUM_LOW", "INCREMENT", "PREDICTED"),
    ("ENERGY", "KINETIC"),
    ("TIME", "TIME_END", "RATE"),
)

#: Places in the layout for the driver: the first row of blocks; the row behind the
#: unknowns, the number of coordinates, of rows, how many of the unknowns are measured, how many
#: steps an explicit kernel may take in one call, as it gets the time of the first, from one
#: input to the next how many rows; where it stands how variations grow, and how many of them are
#: made orthonormal, after each so many steps; how many recorders look for events, before all
#: others, and how many are called last, both with the time of the state. Behind all that, the first
#: row and the number of those that are stored with states, of each recorder.
DRIVER_LAYOUT = {
    name: place
    for place, name in enumerate(
        (
            *(block.name for block in TABLE if block.for_driver),
            *("STATE_END", "DIMENSION", "ROWS", "MEASURED", "STEPS_A_CALL", "INPUT_STRIDE"),
            *("GROWN", "RENEWED", "RENEWAL", "OF_EVENTS", "OF_STATES"),
        )
    )
}


def rows_of_blocks(first: Mapping[str, int]) -> dict[str, range]:
    """Return the rows of each block, by where the blocks of a module begin.

    Behind the last block are rows that the module knows nothing of, so it has none.
    """
    known = sorted({first[name] for name in BLOCKS if name in first})
    ends = dict(pairwise(known))
    return {
        block.name: range(first[block.name], ends.get(first[block.name], first[block.name]))
        for block in TABLE
        if block.name in first
    }


def scratch(first: Mapping[str, int]) -> dict[str, range]:
    """Return the rows of each block in which no kernel leaves anything to others."""
    return {name: rows for name, rows in rows_of_blocks(first).items() if BLOCKS[name].scratch}


def layout(sizes: Sizes) -> tuple[dict[str, int], int]:
    """Return the first row of each block that a module has, and the number of rows.

    The blocks from POSITION to INCREMENT are the state of a trajectory: position and momentum,
    what compensated summation carries along, and the increments of the control points, from which
    the next step is predicted.
    """
    first: dict[str, int] = {}
    row = 0
    for block in TABLE:
        rows = int(block.size(sizes))
        if rows or not block.optional:
            first[block.name] = row
        row += rows
    if sizes.differentiated:
        first["TANGENT"] = row  # behind all others, as much as a run needs
    return first, row
