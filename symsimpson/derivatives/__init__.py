"""Derivatives of runs, and what is found with them."""
