"""Where things stand in the workspace: blocks of rows, one column a lane."""

from __future__ import annotations

from collections.abc import Mapping

from symsimpson.codegen.storage import Storage
from symsimpson.discrete.unknowns import Unknowns
from symsimpson.module.interface import BLOCKS, OPTIONAL
from symsimpson.schemes.scheme import Scheme

__all__ = ["layout", "node_stride"]

#: Nodes are filled up to a multiple of this: a vector register of the widest machines.
REGISTER = 8


def node_stride(scheme: Scheme) -> int:
    """Return the rows of a value that all nodes have: more than nodes where these are lanes."""
    full = -(-scheme.stages // REGISTER) * REGISTER
    return full if scheme.by_stages else scheme.stages


def layout(
    storage: Storage, unknowns: Unknowns, sizes: Mapping[str, int], *, constant_mass: bool
) -> tuple[dict[str, int], int]:
    """Return the first row of each block, and the number of rows.

    ``sizes`` are those of blocks that depend on the module: parameters, invariants, hoisted
    values, coefficients of families and what belongs to stages.

    The blocks from POSITION to INCREMENT are the state of a trajectory: position and momentum,
    what compensated summation carries along, and the increments of the control points, from which
    the next step is predicted.
    """
    n = storage.n
    every = {
        **dict.fromkeys(BLOCKS, 1),
        **dict.fromkeys(("POSITION", "POSITION_LOW", "MOMENTUM", "MOMENTUM_LOW"), n),
        "INCREMENT": unknowns.size,
        "PREDICTED": unknowns.size,
        "PREVIOUS": 4 * n + unknowns.size,
        "SOLVED": unknowns.size,
        "VELOCITY": n,
        **dict.fromkeys(
            ("NODE_POSITION", "NODE_VELOCITY", "NODE_L_Q", "NODE_L_V", "MASS_DIAGONAL"), n
        ),
        **dict.fromkeys(("NODE_L_QQ", "NODE_L_QV", "NODE_L_VV"), storage.node_size),
        "MASS": storage.node_size if constant_mass else 0,
        "RESIDUAL": unknowns.size,
        **sizes,
    }
    first: dict[str, int] = {}
    row = 0
    for block in BLOCKS:
        if block in OPTIONAL and not sizes.get(block):
            continue
        first[block] = row
        row += every[block]
    return first, row
