"""The workspace of kernels, and what stands for inputs where there are none."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from symsimpson.module.header import Header
from symsimpson.support.array_types import Reals

if TYPE_CHECKING:
    from symsimpson.program.numbers import Numbers


#: Inputs of a system without any: by member, step, node and number.
NO_INPUTS = np.zeros((1, 1, 1, 0))


def workspace(header: Header, numbers: Numbers, parameters: Reals, more: int = 0) -> Reals:
    """Make the workspace of one lane, with the parameters in it and so many further rows.

    The last row is the driver's: what the terms of forces add to positions, over h^4.
    """
    W = numbers.zeros((header.rows + more + 1, 1))
    first = header.layout["PARAMETER"]
    W[first : first + parameters.size, 0] = parameters
    return W
