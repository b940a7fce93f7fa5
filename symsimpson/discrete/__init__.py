"""Discrete mechanics: the jet of L at a node, and the equations of a step from jets."""
