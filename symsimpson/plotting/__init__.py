"""Figures; needs matplotlib and plotly (the extra ``plot``)."""

from symsimpson.plotting.convergence import plot_convergence, slope_triangle
from symsimpson.plotting.work_precision import plot_work_precision

__all__ = ["plot_convergence", "plot_work_precision", "slope_triangle"]
