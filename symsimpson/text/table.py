"""Blocks of the workspace: their contents, their sizes, which ones the driver knows."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from operator import attrgetter


@dataclass(frozen=True, kw_only=True)
class Sizes:
    """Numbers of a module that sizes of blocks follow from; 0 or False for what it has not."""

    #: Numbers of coordinates, constraints, those of velocities among them, those that may have a
    #: right-hand side, and so on.
    n: int
    m: int = 0
    rolling: int = 0
    sides: int = 0
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
    #: Whether M has eigenvalues of both signs, and whether L is not quadratic in the velocities.
    indefinite: bool = False
    inverted: bool = False
    canonical: bool = False  #: Whether the system is declared by H, and p are unknowns, too.
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


Size = Callable[[Sizes], int]


def one(s: Sizes) -> int:
    """Return the size of a block of one row."""
    return 1


def none(s: Sizes) -> int:
    """Return the size of a block that has no row of its own."""
    return 0


coordinates, constraints = attrgetter("n"), attrgetter("m")
unknowns = attrgetter("unknowns")


def at_node(s: Sizes) -> int:
    """Return the number of coordinates, where loops go over nodes."""
    return s.by_nodes * s.n


def entries(s: Sizes) -> int:
    """Return the size of an n by n matrix at a node, where loops go over nodes."""
    return s.by_nodes * s.entries


def cyclic(s: Sizes) -> int:
    """Return the number of cyclic coordinates at all nodes, and at the ends of the path."""
    return s.cyclic * (s.nodes + 2)


@dataclass(frozen=True)
class Block:
    """Rows of the workspace that belong together."""

    name: str  #: The constant of a module that holds its first row.
    doc: str
    size: Size = one  #: Gives the number of rows.
    for_driver: bool = False  #: Whether the driver needs to know where it stands.
    optional: bool = False  #: Whether a module has it only if it has rows in it.
    scratch: bool = False  #: Whether no kernel reads what another one has left there.


def part(name: str, doc: str, size: Size = one, for_driver: bool = False) -> Block:
    """Return a block of systems that need it: with constraints, inputs, stages, derivatives."""
    return Block(name, doc, size, for_driver, optional=True)


def scratch(name: str, doc: str, size: Size) -> Block:
    """Return such a block, in which no kernel leaves anything to others."""
    return Block(name, doc, size, optional=True, scratch=True)


#: All of them, in their order. Sizes that are spoken of are squared norms with the diagonal of
#: M(q0) as weights.
TABLE = (
    Block("ACTIVE", "1: to be solved, 0: done, negative: failed, with a status", for_driver=True),
    Block("CORRECTION_SQUARED", "size of the last correction"),
    Block("INCREMENT_SQUARED", "size of the increments", for_driver=True),
    Block(
        "VELOCITY_JUMP_SQUARED",
        "between the end of a path and the velocity there, times h",
        for_driver=True,
    ),
    Block(
        "PREDICTION_ERROR_SQUARED", "size of what the increments differ by from the predicted ones"
    ),
    Block("CYCLIC_JUMP_SQUARED", "the velocity jump of cyclic coordinates alone"),
    Block("CYCLIC_MASS_CHANGE", "relative change of M of cyclic coordinates over the step"),
    Block(
        "MASS_PIVOT",
        "at the start below 0 if M is singular or should be definite, then its smallest pivot",
        for_driver=True,
    ),
    Block("ENERGY", "the Hamiltonian", for_driver=True),
    Block("KINETIC", "its kinetic part"),
    Block("STATUS", "0: going on, else why the lane stopped", for_driver=True),
    Block("RELATIVE", "correction relative to the increments, squared", for_driver=True),
    Block("CONTRACTION", "rate at which corrections shrink", for_driver=True),
    Block("LARGEST_SQUARED", "size of the largest increments so far", for_driver=True),
    Block(
        "IN_DOUBT",
        "0: accepted, 1: to be verified, 2: unresolved, 3: possibly unresolved, 4 more: M is small",
        for_driver=True,
    ),
    Block("ITERATIONS", "since the last stored state", for_driver=True),
    Block("COUNT", "steps that an explicit kernel takes in one call", for_driver=True),
    Block("POSITION", "q", coordinates, for_driver=True),
    Block("POSITION_LOW", "what rounding has taken from q", coordinates),
    Block("MOMENTUM", "p", coordinates, for_driver=True),
    Block("MOMENTUM_LOW", "what rounding has taken from p", coordinates),
    Block("INCREMENT", "control points of the path less q0", unknowns, for_driver=True),
    Block("PREDICTED", "those that the iteration began with", unknowns),
    Block("OWN_CORRECTION", "size of the last correction of each coordinate", coordinates),
    Block("OWN_INCREMENT", "size of the increments of each coordinate", coordinates),
    Block(
        "PREVIOUS",
        "the state before the step, and the increments predicted then",
        lambda s: 4 * s.n + s.unknowns,
        for_driver=True,
    ),
    Block("SOLVED", "the increments of the step", unknowns, for_driver=True),
    Block("VELOCITY", "v", coordinates, for_driver=True),
    Block("PARAMETER", "parameters", lambda s: s.parameters, for_driver=True),
    part("INVARIANT", "quantities to watch", lambda s: s.invariants),
    part("HOISTED", "values that are computed once a run or a step", lambda s: s.hoisted),
    scratch("NODE_POSITION", "q at a node", at_node),
    scratch("NODE_VELOCITY", "v at a node", at_node),
    part("NODE_L_Q", "F at a node", at_node),
    part("NODE_L_V", "P, or a, at a node", at_node),
    scratch("NODE_L_QQ", "F_q at a node", entries),
    scratch("NODE_L_QV", "F_v at a node", entries),
    part("NODE_L_VV", "M at a node", entries),
    scratch("NODE_P_Q", "derivatives of the velocity by q", lambda s: s.canonical * s.entries),
    part("PHASE_SIZE", "sizes of the last moves of q and p", lambda s: 2 * s.canonical * s.n),
    part("MOMENTUM_WEIGHT", "weights of increments of p", lambda s: s.canonical * s.n),
    part(
        "MASS_EXCHANGE",
        "rows of M that elimination has exchanged",
        lambda s: (s.indefinite or s.canonical) * s.n,
    ),
    scratch(
        "SOUGHT",
        "of a velocity that is sought: weights and size of p, the velocity before, its change",
        lambda s: s.inverted * (3 * s.n + 1),
    ),
    Block("MASS", "a constant M", lambda s: s.constant_mass * s.entries),
    Block(
        "MASS_DIAGONAL",
        "diagonal of M(q0), or sums of abs(M_ij) if M is indefinite",
        coordinates,
        for_driver=True,
    ),
    part("COEFFICIENT", "factors of the terms of L", lambda s: s.coefficients),
    scratch(
        "NODE_F_V", "derivatives of the forces by v at a node", lambda s: s.dragged * s.entries
    ),
    scratch("NODE_TIME", "t at a node", lambda s: s.timed),
    part(
        "INPUT",
        "inputs of the step, of each its values at all nodes",
        lambda s: s.inputs * s.stride,
        for_driver=True,
    ),
    scratch("NODE_INPUT", "inputs at a node", lambda s: s.inputs),
    part(
        "GROWTH",
        "by how much the weights of nodes have grown, and those of the end of the step",
        lambda s: s.damped * (s.nodes + 1),
    ),
    part("DECAY", "rates of friction in kicks", lambda s: s.decaying * s.n),
    part("POWER", "power of each force, then dL/dt, at a node or a state", lambda s: s.powers),
    part("WORK", "integrals of these over steps", lambda s: s.powers),
    part("WORK_LOW", "what rounding has taken from them", lambda s: s.powers),
    part("STAGE_V", "h b_i v_i", lambda s: s.n * s.staged),
    part("STAGE_F", "h b_i F_i", lambda s: s.n * s.staged),
    scratch("STAGE_Q", "positions at the nodes, less q", lambda s: s.n * s.staged),
    part("STAGE_KICK", "momenta there, less p", lambda s: s.canonical * s.n * s.staged),
    part("STAGE_STEP", "h b_i", lambda s: s.staged),
    part("STAGE_RATE", "1 / (h b_i)", lambda s: s.staged),
    part("STAGE_PLACE", "c_i", lambda s: s.staged_times * s.staged),
    part("STAGE_MU", "from STAGE_V to positions at the nodes", lambda s: s.nodes * s.staged),
    part("STAGE_NU", "from STAGE_F to momenta at the nodes", lambda s: s.nodes * s.staged),
    part("STAGE_AHEAD", "from STAGE_V to that of the next step", lambda s: 2 * s.nodes * s.staged),
    part("STAGE_CORRECTION", "sizes of the corrections at the nodes", lambda s: s.staged),
    part(
        "STAGE_PIVOT", "the smallest pivot of M at each node", lambda s: min(1, s.pivots) * s.staged
    ),
    part("STAGE_SIZE", "sizes of the increments at the nodes", lambda s: s.staged),
    scratch(
        "STAGE_HELD",
        "values between the two halves of an iteration",
        lambda s: s.staged_values * s.staged,
    ),
    part(
        "STAGE_ANGLE", "angles at the nodes, of an iteration before", lambda s: s.angles * s.staged
    ),
    part("STAGE_SINE", "their sines", lambda s: s.angles * s.staged),
    part("STAGE_COSINE", "their cosines", lambda s: s.angles * s.staged),
    part(
        "STAGE_TURN",
        "changes of the angles since then, squared and added up",
        lambda s: min(1, s.angles) * s.staged,
    ),
    part(
        "STAGE_TURNED",
        "iterations after which sines and cosines are turned by these",
        lambda s: min(1, s.angles),
    ),
    part("STAGE_EXPECTED", "iterations before convergence is checked", lambda s: min(1, s.staged)),
    part("STAGE_COUNT", "iterations of the step", lambda s: min(1, s.staged)),
    part("MULTIPLIER", "multipliers of constraints at a control point, or of a state", constraints),
    part("CONSTRAINT", "phi at a point", constraints),
    part("CONSTRAINT_FORCE", "Phi^T lambda there", lambda s: s.constrained * s.n),
    part(
        "CONSTRAINT_QQ",
        "second derivatives of lambda.phi by q and lambda there",
        lambda s: s.bordered,
    ),
    part("SLIP", "A v - b of velocity constraints at a point", lambda s: s.rolling),
    part("SLIP_Q", "its derivatives by q", lambda s: s.sides * s.n),
    part("SLIP_V", "those by v, A", lambda s: min(1, s.rolling) * s.sides * s.n),
    part(
        "TAKEN",
        "multipliers of the projection of p at the end of a step",
        lambda s: s.carried * s.m,
    ),
    part("CONSTRAINT_WEIGHT", "how much of each constraint was added to M", constraints),
    part("HELD", "M bordered by Phi, factorised", lambda s: s.bordered),
    part(
        "HELD_RIGHT",
        "right side of its equations, or all rows in another order",
        lambda s: s.constrained * (s.n + s.m) * s.degree,
    ),
    part("HELD_PIVOT", "what is left of each constraint in them", constraints),
    part("HELD_CHANGE", "change of q that takes phi to zero", lambda s: s.constrained * s.n),
    part(
        "DRIFT_VELOCITY",
        "velocity of a drift that constraints hold",
        lambda s: s.constrained * s.drifting * s.n,
    ),
    part("CURVATURE", "Phi v, or Phi v', as constraints ask for it", constraints),
    part(
        "INDEPENDENCE",
        "how far constraints are from following from one another: 0 to 1",
        lambda s: s.constrained,
    ),
    Block("RESIDUAL", "residual, then the correction", unknowns, scratch=True),
    Block("JACOBIAN", "its derivatives", lambda s: s.jacobian, scratch=True),
    scratch("CYCLIC_D", "M of cyclic coordinates is L D L^T: D, at nodes and ends", cyclic),
    scratch("CYCLIC_L", "L there, where it depends on q", lambda s: s.cyclic * cyclic(s)),
    scratch("CYCLIC_FIXED", "and where it does not", lambda s: s.cyclic * cyclic(s)),
    scratch("CYCLIC_INVERSE", "1 / D there", cyclic),
    scratch("CYCLIC_P", "L^-1 (p - P at v_y = 0), then that of P", cyclic),
    scratch("CYCLIC_V", "velocities of cyclic coordinates", cyclic),
    scratch("CYCLIC_GAP", "L^-1 (P - p) at the end of the path", lambda s: s.cyclic),
    scratch(
        "CYCLIC_T", "L^-1 L_o at nodes, for L_o at one of them", lambda s: s.cyclic * cyclic(s)
    ),
    scratch("CYCLIC_MATRIX", "matrix of multipliers", lambda s: s.cyclic_multipliers**2),
    scratch("CYCLIC_LAMBDA", "multipliers, or how they change", lambda s: s.cyclic_multipliers),
    scratch("CYCLIC_E", "L^-1 P_q of cyclic momenta", lambda s: s.cyclic * s.n),
    scratch("CYCLIC_F", "L^-1 M, their rows", lambda s: s.cyclic * s.n),
    scratch("CYCLIC_DE", "D^-1 times the former, at nodes", lambda s: s.n * cyclic(s)),
    scratch("CYCLIC_DF", "D^-1 times the latter", lambda s: s.n * cyclic(s)),
    scratch(
        "CYCLIC_PULL",
        "derivatives of the rows of multipliers by control points",
        lambda s: s.cyclic_multipliers * s.n * (s.degree + 1),
    ),
    part("PIVOT_SCALE", "1 / pivot of M at the start", lambda s: s.pivots, for_driver=True),
    Block("PIVOT_LIMIT", "pivots of M below this are looked at", for_driver=True),
    Block("PIVOT_TIME", "when steps last passed one and may not resolve it", for_driver=True),
    part(
        "NODE_F_A",
        "derivatives of F by the parameters that are varied, at a node",
        lambda s: s.f_slopes,
    ),
    part("NODE_P_A", "those of P", lambda s: s.p_slopes),
    part(
        "NODE_STEP",
        "h, the place of a node in the step, and 1 if v there goes with 1/h",
        lambda s: 3 * max(s.sized, s.second),
    ),
    part(
        "TIME_GRID",
        "1 if h moves the times of all steps, else 0; the first time; the number of steps since",
        lambda s: 3 * s.sized * s.timed,
    ),
    part(
        "CONSTRAINT_A",
        "derivatives of phi by the parameters that are varied, at a control point",
        lambda s: s.varied * s.m,
    ),
    part("SLIP_A", "those of A v - b, or of b", lambda s: s.varied * s.sides),
    part("CONSTRAINT_QA", "those of Phi^T lambda", lambda s: s.varied * s.constrained * s.n),
    part(
        "EXCHANGE", "which rows elimination has exchanged", lambda s: s.differentiated * s.unknowns
    ),
    scratch(
        "START_SLOPES",
        "derivatives of the rows of a step by q0, increments held",
        lambda s: s.differentiated * s.degree * s.entries,
    ),
    scratch(
        "END_SLOPES",
        "those of p1 - p0 by q0, then by increments in the order of elimination",
        lambda s: s.differentiated * (s.degree + 1) * s.entries,
    ),
    scratch(
        "ROW",
        "h D_k L_d one by one, where M is constant",
        lambda s: s.assembled * s.constant_mass * s.degree * s.n,
    ),
    scratch("STEP_F", "h b_i F at all nodes", lambda s: s.assembled * s.nodes * s.n),
    scratch("STEP_P", "h b_i P at all nodes", lambda s: s.assembled * s.nodes * s.n),
    scratch("STEP_QQ", "F_q at all nodes", lambda s: s.assembled * s.nodes * s.entries),
    scratch("STEP_QV", "F_v at all nodes", lambda s: s.assembled * s.nodes * s.entries),
    scratch("STEP_VV", "M at all nodes", lambda s: s.assembled * s.nodes * s.entries),
    scratch(
        "STEP_SLOPES",
        "derivatives of V and F by q and p at all nodes",
        lambda s: 4 * s.canonical * s.nodes * s.entries,
    ),
    scratch(
        "STEP_F_V",
        "derivatives of the forces by v at all nodes",
        lambda s: s.assembled * s.dragged * s.nodes * s.entries,
    ),
    scratch(
        "STEP_F_A", "derivatives of F by parameters at all nodes", lambda s: s.nodes * s.f_slopes
    ),
    scratch("STEP_P_A", "those of P", lambda s: s.nodes * s.p_slopes),
    scratch(
        "POINT_QQ",
        "second derivatives of lambda.phi at all control points",
        lambda s: s.differentiated * (s.degree + 1) * s.bordered,
    ),
    scratch(
        "POINT_A",
        "derivatives of phi by parameters at these",
        lambda s: (s.degree + 1) * s.varied * s.m,
    ),
    scratch(
        "POINT_QA",
        "those of Phi^T lambda",
        lambda s: (s.degree + 1) * s.varied * s.constrained * s.n,
    ),
    scratch(
        "DERIVATIVE",
        "what parameters change at the end of the step, then the numbers that move variations",
        lambda s: s.by_columns * 2 * s.n * (2 * s.n + s.varied),
    ),
    scratch(
        "CONDENSED",
        "second derivatives of L_d, by q0, too",
        lambda s: s.by_columns * (s.unknowns + 2 * s.n) * (s.unknowns + s.n + s.varied),
    ),
    part("ADJOINT", "derivatives of a cost by q and p", lambda s: 2 * s.differentiated * s.n),
    part(
        "ADJOINT_RIGHT",
        "right side of the equations of a step for them, or their solution",
        lambda s: s.differentiated * s.unknowns,
    ),
    part(
        "ADJOINT_START",
        "derivative of a cost by q at the start of a step, through forces and momenta",
        lambda s: s.differentiated * s.n * (1 + s.canonical),
    ),
    part(
        "COST",
        "integral of a running cost, and what rounding has taken from it",
        lambda s: 2 * s.costly,
    ),
    part(
        "COST_END",
        "derivatives of a cost by these parameters, through the end of a step",
        lambda s: s.varied * s.constrained,
    ),
    part(
        "COST_SLOPE",
        "derivatives of a cost by the parameters that are varied, through each node",
        lambda s: s.differentiated * max(1, s.varied * s.nodes),
    ),
    part(
        "NODE_COST",
        "a running cost at a node, its derivatives by q, by v and by these parameters",
        lambda s: s.costly * (1 + 2 * s.n + s.varied),
    ),
    part(
        "ROW_WEIGHT",
        "weights of D_k L_d, k = 0..d, then of phi(X_k)",
        lambda s: s.second * (s.degree + 1) * (s.n + s.m),
    ),
    part("COST_WEIGHT", "that of the running cost", lambda s: s.second),
    part("NODE_WEIGHT", "what these are at a node", lambda s: s.second * (2 * s.n + 1)),
    part("NODE_CURVATURE", "second derivatives at a node", lambda s: s.curvatures),
    part("POINT_CURVATURE", "those at a control point", lambda s: s.point_curvatures),
    part(
        "HESSIAN",
        "second derivatives of a step, by control points, multipliers and what is varied",
        lambda s: s.second * ((s.degree + 1) * s.n + s.degree * s.m + s.varied * s.nodes) ** 2,
    ),
    part(
        "TIME",
        "t and what rounding has taken from it, then both before the step",
        lambda s: 4 * s.retimed,
        for_driver=True,
    ),
    part("TIME_END", "1 and the time at which the run ends, or 0", lambda s: 2 * s.retimed),
    part("RATE", "dt/dtau at a node or a state", lambda s: s.retimed),
    part("PASSED", "time that a step takes", lambda s: s.retimed),
    part(
        "TANGENTS",
        "number of variations of the state that are carried along",
        lambda s: s.differentiated,
    ),
    part("TANGENT", "these variations, or the record of a step", none, for_driver=True),
)
