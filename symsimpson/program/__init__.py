"""Modules that are ready to run: kernels, arithmetic, names and cache."""
