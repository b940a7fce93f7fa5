"""Arcs of a solution: where inputs are at their bounds, and where they are between."""

from __future__ import annotations

from itertools import groupby
from typing import Any

import numpy as np

from symsimpson.support.array_types import Floats, Ints

__all__ = ["arcs_of", "labels_of"]

#: An input is at a bound if the rest is this part of its range; in as many steps a switch is seen.
AT_BOUND, OF_A_SWITCH = 0.02, 2


def arcs_of(result: Any) -> list[dict[Any, float]]:
    """Return which inputs stay at a bound, arc by arc."""
    layout = result.layout
    read, means = layout.read, result.input_values.mean(axis=1)
    labels = np.zeros(means.shape, dtype=np.int64)
    for k, (low, high) in read.of_inputs.items():
        if np.isfinite(low) and np.isfinite(high) and low < high:
            labels[:, k] = labels_of((means[:, k] - low) / (high - low))
    inputs, bounds = read.system.inputs, read.of_inputs
    return [
        {inputs[k]: bounds[k][label > 0] for k, label in enumerate(row) if label}
        for row, _ in groupby(map(tuple, labels.tolist()))
    ]


def labels_of(part: Floats) -> Ints:
    """Return -1 or 1 where an input is at a bound, 0 where it is between them for some steps.

    A few steps between two bounds have a switch in them, and belong to the nearer one.
    """
    labels = np.where(part < AT_BOUND, -1, np.where(part > 1 - AT_BOUND, 1, 0))
    first = 0
    for label, same in groupby(labels.tolist()):
        last = first + len([*same])
        if not label and last - first <= OF_A_SWITCH:
            labels[first:last] = np.where(part[first:last] < 0.5, -1, 1)
        first = last
    return labels
