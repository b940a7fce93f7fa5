"""The agreement between generated modules and the driver that calls their kernels.

A kernel is a function ``kernel(h, t, workspace)``. Everything that a run remembers stands in the
workspace: blocks of rows, one column for each lane. What both sides must know of it is said here
and nowhere else. This text is compiled in front of the driver's, so it imports nothing.
"""

#: Number of the agreement; modules with another number are refused.
INTERFACE = 9

#: The type of a kernel, and what the compiler is told: contract and nsz keep NaN checks and
#: compensated sums, "fast" would delete both.
SIGNATURE = "void(float64, float64, CPointer(float64))"
OPTIONS = '{"fastmath": {"contract", "nsz"}, "error_model": "numpy"}'

#: Blocks of the workspace in their order, and what stands there. Sizes are squared norms with the
#: diagonal of M(q0) as weights.
BLOCKS = {
    "ACTIVE": "1: to be solved, 0: done, negative: failed, with a status",
    "CORRECTION_SQUARED": "size of the last correction",
    "INCREMENT_SQUARED": "size of the increments",
    "VELOCITY_JUMP_SQUARED": "between the end of a path and the velocity there, times h",
    "PREDICTION_ERROR_SQUARED": "size of what the increments differ by from the predicted ones",
    "CYCLIC_JUMP_SQUARED": "the velocity jump of cyclic coordinates alone",
    "CYCLIC_MASS_CHANGE": "relative change of M of cyclic coordinates over the step",
    "MASS_PIVOT": "below 0 if M is not positive definite",
    "ENERGY": "the Hamiltonian",
    "KINETIC": "its kinetic part",
    "STATUS": "0: going on, else why the lane stopped",
    "RELATIVE": "correction relative to the increments, squared",
    "CONTRACTION": "rate at which corrections shrink",
    "LARGEST_SQUARED": "size of the largest increments so far",
    "IN_DOUBT": "0: accepted, 1: to be verified, 2: unresolved, 3: possibly unresolved",
    "ITERATIONS": "since the last stored state",
    "COUNT": "steps that an explicit kernel takes in one call",
    "POSITION": "q",
    "POSITION_LOW": "what rounding has taken from q",
    "MOMENTUM": "p",
    "MOMENTUM_LOW": "what rounding has taken from p",
    "INCREMENT": "control points of the path less q0",
    "PREDICTED": "those that the iteration began with",
    "PREVIOUS": "the state before the step, and the increments predicted then",
    "SOLVED": "the increments of the step",
    "VELOCITY": "v",
    "PARAMETER": "parameters",
    "INVARIANT": "quantities to watch",
    "HOISTED": "values that are computed once a run or a step",
    "NODE_POSITION": "q at a node",
    "NODE_VELOCITY": "v at a node",
    "NODE_L_Q": "F at a node",
    "NODE_L_V": "P, or a, at a node",
    "NODE_L_QQ": "F_q at a node",
    "NODE_L_QV": "F_v at a node",
    "NODE_L_VV": "M at a node",
    "MASS": "a constant M",
    "MASS_DIAGONAL": "diagonal of M(q0)",
    "COEFFICIENT": "factors of the terms of L",
    "NODE_F_V": "derivatives of the forces by v at a node",
    "NODE_TIME": "t at a node",
    "INPUT": "inputs of the step, of each its values at all nodes",
    "NODE_INPUT": "inputs at a node",
    "GROWTH": "by how much the weights of nodes have grown, and those of the end of the step",
    "POWER": "power of each force, then dL/dt, at a node or a state",
    "WORK": "integrals of these over steps",
    "STAGE_V": "h b_i v_i",
    "STAGE_F": "h b_i F_i",
    "STAGE_Q": "positions at the nodes, less q",
    "STAGE_P": "momenta at the nodes, less p",
    "STAGE_STEP": "h b_i",
    "STAGE_RATE": "1 / (h b_i)",
    "STAGE_PLACE": "c_i",
    "STAGE_MU": "from STAGE_V to positions at the nodes",
    "STAGE_NU": "from STAGE_F to momenta at the nodes",
    "STAGE_AHEAD": "from STAGE_V to that of the next step",
    "STAGE_CORRECTION": "sizes of the corrections at the nodes",
    "STAGE_SIZE": "sizes of the increments at the nodes",
    "STAGE_HELD": "values between the two halves of an iteration",
    "STAGE_ANGLE": "angles at the nodes, of an iteration before",
    "STAGE_SINE": "their sines",
    "STAGE_COSINE": "their cosines",
    "STAGE_TURN": "changes of the angles since then, squared and added up",
    "STAGE_TURNED": "iterations after which sines and cosines are turned by these",
    "STAGE_EXPECTED": "iterations before convergence is checked",
    "STAGE_COUNT": "iterations of the step",
    "MULTIPLIER": "multipliers of constraints at a control point, or of a state",
    "CONSTRAINT": "phi at a point",
    "CONSTRAINT_FORCE": "Phi^T lambda there",
    "CONSTRAINT_QQ": "second derivatives of lambda.phi by q and lambda there",
    "CONSTRAINT_WEIGHT": "how much of each constraint was added to M",
    "HELD": "M bordered by Phi, factorised",
    "HELD_RIGHT": "right side of its equations, or all rows in another order",
    "HELD_PIVOT": "what is left of each constraint in them",
    "HELD_CHANGE": "change of q that takes phi to zero",
    "DRIFT_VELOCITY": "velocity of a drift that constraints hold",
    "CURVATURE": "Phi v, or Phi v', as constraints ask for it",
    "DEPENDENCE": "how far constraints are from following from one another: 0 to 1",
    "RESIDUAL": "residual, then the correction",
    "JACOBIAN": "its derivatives",
    "NODE_F_A": "derivatives of F by the parameters that are varied, at a node",
    "NODE_P_A": "those of P",
    "CONSTRAINT_A": "derivatives of phi by the parameters that are varied, at a control point",
    "CONSTRAINT_QA": "those of Phi^T lambda",
    "EXCHANGE": "which rows elimination has exchanged",
    "DERIVATIVE": "of the end of the step, column by column: by q, by p and by what is varied",
    "ADJOINT": "derivatives of a cost by q and p",
    "ADJOINT_RIGHT": "right side of the equations of a step for them, or their solution",
    "ADJOINT_START": "derivative of a cost by q at the start of a step, through forces and momenta",
    "COST": "integral of a running cost, and what rounding has taken from it",
    "COST_END": "derivatives of a cost by these parameters, through the end of a step",
    "COST_SLOPE": "derivatives of a cost by the parameters that are varied, through each node",
    "NODE_COST": "a running cost at a node, its derivatives by q, by v and by these parameters",
    "TIME": "t and what rounding has taken from it, then both before the step",
    "TIME_END": "1 and the time at which the run ends, or 0",
    "RATE": "dt/dtau at a node or a state",
    "PASSED": "time that a step takes",
    "TANGENTS": "number of variations of the state that are carried along",
    "TANGENT": "these variations, or what else is kept behind each step; as long as a run asks for",
}

#: Blocks of systems that need them: with forces, t, inputs, damped momenta, constraints, stages.
OPTIONAL = (
    "MULTIPLIER",
    "CONSTRAINT",
    "CONSTRAINT_FORCE",
    "CONSTRAINT_QQ",
    "CONSTRAINT_WEIGHT",
    "HELD",
    "HELD_RIGHT",
    "HELD_PIVOT",
    "HELD_CHANGE",
    "DRIFT_VELOCITY",
    "CURVATURE",
    "DEPENDENCE",
    "NODE_F_V",
    "NODE_TIME",
    "INPUT",
    "NODE_INPUT",
    "GROWTH",
    "POWER",
    "WORK",
    "NODE_F_A",
    "NODE_P_A",
    "CONSTRAINT_A",
    "CONSTRAINT_QA",
    "EXCHANGE",
    "DERIVATIVE",
    "ADJOINT",
    "ADJOINT_RIGHT",
    "ADJOINT_START",
    "COST",
    "COST_END",
    "COST_SLOPE",
    "NODE_COST",
    "TANGENTS",
    "TANGENT",
    "TIME",
    "TIME_END",
    "RATE",
    "PASSED",
    *(block for block in BLOCKS if block.startswith("STAGE_")),
)

#: Blocks that must stand right behind one another: the driver moves them as one.
ADJACENT = (
    ("POSITION", "POSITION_LOW", "MOMENTUM", "MOMENTUM_LOW", "INCREMENT", "PREDICTED"),
    ("ENERGY", "KINETIC"),
    ("TIME", "TIME_END", "RATE"),
)
#: From TIME to RATE.
RATE_BEHIND = 6

#: What the driver is told of a module, in this order: rows of blocks, the row behind the
#: unknowns, the number of coordinates, how many of the unknowns are measured, how many steps an
#: explicit kernel may take in one call, as it is told the time of the first, from one input to
#: the next how many rows, where variations of the state begin, where what is stored beside
#: states, and how many variations are made orthonormal, after each so many steps.
TOLD = (
    "ACTIVE",
    "VELOCITY_JUMP_SQUARED",
    "STATUS",
    "CONTRACTION",
    "LARGEST_SQUARED",
    "ITERATIONS",
    "POSITION",
    "MOMENTUM",
    "INCREMENT",
    "STATE_END",
    "MASS_DIAGONAL",
    "DIMENSION",
    "PREVIOUS",
    "SOLVED",
    "COUNT",
    "RELATIVE",
    "IN_DOUBT",
    "ENERGY",
    "INCREMENT_SQUARED",
    "VELOCITY",
    "PARAMETER",
    "MASS_PIVOT",
    "ROWS",
    "MEASURED",
    "STEPS_A_CALL",
    "INPUT",
    "INPUT_STRIDE",
    "TANGENT",
    "KEPT",
    "RENEWED",
    "RENEWAL",
)
(
    ACTIVE,
    VELOCITY_JUMP_SQUARED,
    STATUS,
    CONTRACTION,
    LARGEST_SQUARED,
    ITERATIONS,
    POSITION,
    MOMENTUM,
    INCREMENT,
    STATE_END,
    MASS_DIAGONAL,
    DIMENSION,
    PREVIOUS,
    SOLVED,
    COUNT,
    RELATIVE,
    IN_DOUBT,
    ENERGY,
    INCREMENT_SQUARED,
    VELOCITY,
    PARAMETER,
    MASS_PIVOT,
    ROWS,
    MEASURED,
    STEPS_A_CALL,
    INPUT,
    INPUT_STRIDE,
    TANGENT,
    KEPT,
    RENEWED,
    RENEWAL,
) = range(len(TOLD))

# values in STATUS, and negative ones in ACTIVE
SUCCESS, INTERRUPTED, NOT_CONVERGED, NOT_FINITE, STEP_TOO_LARGE, BAD_INPUT = range(6)
COORDINATE_SINGULARITY, DIVERGED, SINGULAR_JACOBIAN, FILE_ERROR = range(6, 10)
SINGULAR_CONSTRAINTS, ARRIVED, RATE_NOT_POSITIVE = 10, 11, 12

# values in IN_DOUBT
ACCEPTED, TO_BE_VERIFIED, UNRESOLVED, POSSIBLY_UNRESOLVED = range(4)

#: How a set of kernels takes a step: by none but itself; by Newton's method; by an iteration over
#: stages; by Newton's method where that failed, with the energy watched as in all steps by stages.
EXPLICIT, NEWTON, STAGES, NEWTON_AFTER_STAGES = range(4)

#: A set of kernels as the driver takes it: the mode, then addresses, 0 where there is none.
MODE, PREPARE, START, ITERATE, ADVANCE, MEASURE, BEHIND = range(7)

#: The kernels of each set by name, in that order; one to be called behind each step may follow.
KERNEL_SETS = {
    EXPLICIT: ("prepare", "start", "", "advance", ""),
    NEWTON: ("prepare", "start", "newton", "advance", ""),
    STAGES: ("prepare", "start_stages", "iterate", "advance_stages", ""),
    NEWTON_AFTER_STAGES: ("prepare", "start", "newton", "advance", "energy"),
}
#: What takes the place of Newton's method, or of another kernel, where a pivot was zero.
WITH_PIVOTS = "_pivoted"
PIVOTED = f"newton{WITH_PIVOTS}"
#: All kernels that a module may have.
KERNELS = (
    "prepare",
    "start",
    "legendre",
    "newton",
    "newton_pivoted",
    "advance",
    "start_stages",
    "iterate",
    "advance_stages",
    "energy",
    "invariants",
    "equations",
    "power",
    "work",
    "multipliers",
    "tangent",
    "tangent_pivoted",
    "momentum_slopes",
    "adjoint",
    "start_adjoint",
    "record",
    "step_cost",
    "running_cost",
    "retime",
    "clock",
    "energy_in_tau",
)
