"""Figures; needs matplotlib (the extra ``notebook``)."""

from symsimpson.plotting.convergence import plot_convergence, slope_triangle

__all__ = ["plot_convergence", "slope_triangle"]
