"""Optimal control: energies in, an exact sparse programme out, and its solution."""
