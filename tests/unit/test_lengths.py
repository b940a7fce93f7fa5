"""Natural lengths of functions."""

import numpy as np
import pytest

from symsimpson.support.lengths import bending_length


@pytest.mark.parametrize("unit", [1e-12, 1.0, 1e11])
def test_circles_bend_on_their_radius_and_lines_nowhere(unit):
    def slopes(q):
        line = np.broadcast_to([1.0, 2.0], q.shape)
        return np.stack([2 * q, line], axis=-2)

    found = bending_length(slopes, np.array([[0.6 * unit, 0.8 * unit]]))
    assert found.shape == (1, 2)
    assert abs(found[0, 0] / unit - 1) < 0.5
    assert found[0, 1] == 0


def test_angles_bend_on_a_turn():
    found = bending_length(lambda q: np.cos(q)[None], np.array([1e-17, 0.0]))
    assert 0.1 < found[0] < 100
