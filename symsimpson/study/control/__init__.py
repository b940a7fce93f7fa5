"""Optimal control: direct transcription to a sparse nonlinear program, and its solution."""
