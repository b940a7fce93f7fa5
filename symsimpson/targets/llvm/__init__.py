"""Kernels from their text: its syntax tree is walked with values, and what these do is the code."""
