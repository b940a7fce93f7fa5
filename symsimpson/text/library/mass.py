"""The mass matrix: velocities from momenta and back."""


@compiled
def factor_mass(W, lane):
    """Factorise M = L D L^T in its place; MASS_PIVOT is twice the sum of negative pivots."""
    first = NODE_L_VV + NODE_OFFSET
    for i in range(DIMENSION):
        W[MASS_DIAGONAL + COORDINATE[i], lane] = W[first + i * NODE_STRIDE + i, lane]
    if TRACED and DIMENSION == 2:  # [[a, b], [d, a d - b^2]]: one division solves then
        a, b, d = W[first, lane], W[first + 1, lane], W[first + NODE_STRIDE + 1, lane]
        W[first + NODE_STRIDE, lane] = d
        W[first + NODE_STRIDE + 1, lane] = a * d - b**2
    else:
        factor_symmetric(W, first, DIMENSION, MASS_BAND, NODE_STRIDE, lane)
    deficit = real(0)
    for i in range(DIMENSION):
        pivot = W[first + i * NODE_STRIDE + i, lane]
        deficit += pivot - abs(pivot)
    W[MASS_PIVOT, lane] = deficit


@compiled
def scale_pivots(W, lane):
    """Store 1 / pivot of M at the start of a run."""
    first = HELD if HELD else NODE_L_VV
    for i in range(DIMENSION):
        W[PIVOT_SCALE + i, lane] = 1 / W[first + PIVOT_AT[i], lane]


@compiled
def least_pivot(W, lane):
    """Return the smallest ratio of a pivot of M to its value at the start."""
    first = HELD if HELD else NODE_L_VV
    least = W[first + PIVOT_AT[0], lane] * W[PIVOT_SCALE, lane]
    for i in range(1, DIMENSION):
        least = min(least, W[first + PIVOT_AT[i], lane] * W[PIVOT_SCALE + i, lane])
    return least


@compiled
def solve_with_mass(W, lane):
    """Solve M v = right in place, in the rows of a node's velocity, with the factors of M."""
    first = NODE_L_VV + NODE_OFFSET
    if TRACED and DIMENSION == 2:
        a, b, d = W[first, lane], W[first + 1, lane], W[first + NODE_STRIDE, lane]
        scale = 1 / W[first + NODE_STRIDE + 1, lane]
        x, y = W[NODE_VELOCITY, lane], W[NODE_VELOCITY + 1, lane]
        W[NODE_VELOCITY, lane] = scale * (d * x - b * y)
        W[NODE_VELOCITY + 1, lane] = scale * (a * y - b * x)
    else:
        solve_symmetric(W, first, NODE_VELOCITY, DIMENSION, MASS_BAND, NODE_STRIDE, lane)


@compiled
def solve_mass(W, lane):
    """Find the velocity of a state; the rows of a node's velocity have its momentum."""
    solve_with_mass(W, lane)
    for i in range(DIMENSION):
        W[VELOCITY + COORDINATE[i], lane] = W[NODE_VELOCITY + i, lane]


@compiled
def momentum(W, lane):
    """Momentum p = M v + a."""
    for s in range(DIMENSION):
        p = W[NODE_L_V + s, lane]
        for b in range(max(0, s - MASS_BAND), min(DIMENSION, s + MASS_BAND + 1)):
            mass = W[NODE_L_VV + s * NODE_STRIDE + b + NODE_OFFSET, lane]
            p += mass * W[NODE_VELOCITY + b, lane]
        W[MOMENTUM + COORDINATE[s], lane] = p


@compiled
def kinetic_energy(W, lane):
    """Begin the energy with v.(p - a)/2, with the velocity that solve_mass found."""
    kinetic = real(0)
    for s in range(DIMENSION):
        a = COORDINATE[s]
        kinetic += (W[MOMENTUM + a, lane] - W[NODE_L_V + s, lane]) * W[VELOCITY + a, lane]
    W[KINETIC, lane] = kinetic / 2
    W[ENERGY, lane] = kinetic / 2
