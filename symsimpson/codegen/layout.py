"""Values that all nodes of a step have: rows beside each other, filled up to a register."""

from __future__ import annotations

from symsimpson.schemes.scheme import Scheme

__all__ = ["node_stride"]

#: Nodes are filled up to a multiple of this: a vector register of the widest machines.
REGISTER = 8


def node_stride(scheme: Scheme) -> int:
    """Return the rows of a value that all nodes have: more than nodes where these are lanes."""
    full = -(-scheme.stages // REGISTER) * REGISTER
    return full if scheme.by_stages else scheme.stages
