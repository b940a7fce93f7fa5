"""A module that is ready to run: kernels, their numbers, names and cache."""
