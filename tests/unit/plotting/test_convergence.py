"""Convergence figures and the numbers in them."""

import numpy as np
import pytest

from symsimpson.study.analysis.order import observed_orders


def test_orders():
    assert observed_orders([8.0, 1.0], ratio=2).tolist() == [3.0]
    assert observed_orders([9.0, 1.0, 1.0], ratio=3) == pytest.approx([2.0, 0.0])


def test_convergence_figure():
    matplotlib = pytest.importorskip("matplotlib")
    matplotlib.use("Agg")
    from symsimpson.plotting import plot_convergence

    h = 0.1 / 2 ** np.arange(5)
    ax = plot_convergence(h, {"one": h**2, "two": h**4}, orders={"two": 4})
    assert [line.get_label() for line in ax.lines if not line.get_label().startswith("_")] == [
        "one",
        "two",
    ]
    triangle = ax.lines[-1].get_xydata()
    slope = np.log(triangle[2, 1] / triangle[1, 1]) / np.log(triangle[1, 0] / triangle[0, 0])
    assert slope == pytest.approx(4)
    assert plot_convergence(h, {"three": h}, ax=ax) is ax
