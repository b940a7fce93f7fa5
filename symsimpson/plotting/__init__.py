"""Figures and animations, which need matplotlib and plotly (the extra ``plot``)."""

from symsimpson.plotting.run_figures import plot_convergence, plot_work_precision, slope_triangle

__all__ = ["plot_convergence", "plot_work_precision", "slope_triangle"]
