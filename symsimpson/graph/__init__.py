"""Expressions as a graph in which everything is written once."""
