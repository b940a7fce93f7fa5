"""Where things stand in the workspace: blocks of rows, one column a lane."""

from __future__ import annotations

from symsimpson.codegen.names import BLOCKS

__all__ = ["layout"]


def layout(
    n: int, degree: int, parameters: int, invariants: int, hoisted: int
) -> tuple[dict[str, int], int]:
    """Give the first row of each block, and the number of rows.

    The blocks from POSITION to INCREMENT are the state of a trajectory: position and momentum,
    what compensated summation carries along, and the increments of the control points, from which
    the next step is predicted.
    """
    unknowns = degree * n
    sizes = {
        **dict.fromkeys(BLOCKS, 1),
        **dict.fromkeys(("POSITION", "POSITION_LOW", "MOMENTUM", "MOMENTUM_LOW"), n),
        "INCREMENT": unknowns,
        "PREDICTED": unknowns,
        "PREVIOUS": 4 * n + unknowns,
        "SOLVED": unknowns,
        "VELOCITY": n,
        "PARAMETER": parameters,
        "INVARIANT": invariants,
        "HOISTED": hoisted,
        **dict.fromkeys(("NODE_POSITION", "NODE_VELOCITY", "NODE_L_Q", "NODE_L_V", "METRIC"), n),
        **dict.fromkeys(("NODE_L_QQ", "NODE_L_QV", "NODE_L_VV"), n * n),
        "RESIDUAL": unknowns,
        "JACOBIAN": unknowns * unknowns,
    }
    first: dict[str, int] = {}
    row = 0
    for block in BLOCKS:
        first[block] = row
        row += sizes[block]
    return first, row
