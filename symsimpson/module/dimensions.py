"""Numbers of a module that the sizes of its blocks follow from."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["Sizes"]


@dataclass(frozen=True, kw_only=True)
class Sizes:
    """Numbers of a module that sizes of blocks follow from; 0 or False for what it has not."""

    #: Numbers of coordinates, constraints, those of velocities among them, and so on.
    n: int
    m: int = 0
    rolling: int = 0
    parameters: int = 0
    inputs: int = 0
    invariants: int = 0
    powers: int = 0
    #: Degree of the path, nodes and unknowns of a step.
    degree: int
    nodes: int
    unknowns: int
    #: Entries of an n by n matrix at a node, of one bordered by constraints, and of the Jacobian.
    entries: int
    bordered: int = 0
    jacobian: int
    #: Values that are computed once a run or a step, factors of the terms of L.
    hoisted: int = 0
    coefficients: int = 0
    pivots: int = 0  #: Pivots of M that change along a motion.
    stride: int = 0  #: Rows of an input: one for each node, or more.
    by_nodes: bool = True  #: Whether loops go over nodes.
    assembled: bool = False  #: Whether they assemble the equations of a step, and the Jacobian.
    #: Whether M is constant, forces depend on v, there is a time at nodes, momenta are damped,
    #: kicks have friction, there are constraints, some do work, steps are kicks and drifts, the
    #: time is not that of the steps.
    constant_mass: bool = False
    dragged: bool = False
    timed: bool = False
    damped: bool = False
    decaying: bool = False
    constrained: bool = False
    carried: bool = False
    drifting: bool = False
    retimed: bool = False
    #: Coordinates, the last ones, that are solved for by their momenta, and multipliers of these.
    cyclic: int = 0
    cyclic_multipliers: int = 0
    #: Rows of a value that all nodes have, where steps are iterated by stages; values between the
    #: halves of an iteration; angles of which sines are kept.
    staged: int = 0
    staged_values: int = 0
    angles: int = 0
    #: Whether they need the times of nodes.
    staged_times: bool = False
    #: Whether steps are differentiated, by columns of their derivative, with a running cost.
    differentiated: bool = False
    by_columns: bool = False
    costly: bool = False
    #: Whether rows of a step are differentiated twice, and a step by its size.
    second: bool = False
    sized: bool = False
    #: Second derivatives that are not zero, at a node and at a control point.
    curvatures: int = 0
    point_curvatures: int = 0
    #: Parameters that are varied; derivatives of F and P by them that are not zero.
    varied: int = 0
    f_slopes: int = 0
    p_slopes: int = 0
