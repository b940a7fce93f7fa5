"""Numbers of a module that the sizes of its blocks follow from."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["Sizes"]


@dataclass(frozen=True, kw_only=True)
class Sizes:
    """Numbers of a module that sizes of blocks follow from; 0 or False for what it has not.

    Attributes
    ----------
    n, m, rolling, parameters, inputs, invariants, powers : int
        Numbers of coordinates, constraints, those of velocities among them, and so on.
    degree, nodes, unknowns : int
        Degree of the path, nodes and unknowns of a step.
    entries, bordered, jacobian : int
        Entries of an n by n matrix at a node, of one bordered by constraints, and of the Jacobian.
    hoisted, coefficients : int
        Values that are computed once a run or a step, factors of the terms of L.
    stride : int
        Rows of an input: one for each node, or more.
    by_nodes, assembled : bool
        Whether loops go over nodes, and whether they assemble the equations of a step.
    constant_mass, dragged, timed, damped, constrained, carried, drifting, retimed : bool
        Whether M is constant, forces depend on v, there is a time at nodes, momenta are damped,
        there are constraints, some do work, steps are kicks and drifts, the time is not that of
        the steps.
    staged, staged_values, angles : int
        Rows of a value that all nodes have, where steps are iterated by stages; values between the
        halves of an iteration; angles of which sines are kept.
    staged_by_loops, staged_times : bool
        Whether loops do so, and need the times of nodes.
    differentiated, by_columns, costly : bool
        Whether steps are differentiated, by columns of their derivative, with a running cost.
    second, sized : bool
        Whether rows of a step are differentiated twice, and a step by its size.
    curvatures, point_curvatures : int
        Second derivatives that are not zero, at a node and at a control point.
    varied, f_slopes, p_slopes : int
        Parameters that are varied; derivatives of F and P by them that are not zero.
    """

    n: int
    m: int = 0
    rolling: int = 0
    parameters: int = 0
    inputs: int = 0
    invariants: int = 0
    powers: int = 0
    degree: int
    nodes: int
    unknowns: int
    entries: int
    bordered: int = 0
    jacobian: int
    hoisted: int = 0
    coefficients: int = 0
    stride: int = 0
    by_nodes: bool = True
    assembled: bool = False
    constant_mass: bool = False
    dragged: bool = False
    timed: bool = False
    damped: bool = False
    constrained: bool = False
    carried: bool = False
    drifting: bool = False
    retimed: bool = False
    staged: int = 0
    staged_values: int = 0
    angles: int = 0
    staged_by_loops: bool = False
    staged_times: bool = False
    differentiated: bool = False
    by_columns: bool = False
    costly: bool = False
    second: bool = False
    sized: bool = False
    curvatures: int = 0
    point_curvatures: int = 0
    varied: int = 0
    f_slopes: int = 0
    p_slopes: int = 0
