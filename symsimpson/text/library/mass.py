"""The mass matrix: velocities from momenta and back."""


@compiled
def factor_mass(W, lane):
    """Factorise M in its place: M = L D L^T, or P M = L U if M is indefinite.

    MASS_PIVOT is twice the sum of negative pivots. If M is indefinite, it is negative where M is
    singular.
    """
    first = NODE_L_VV + NODE_OFFSET
    for i in range(DIMENSION):
        if DEFINITE:
            W[MASS_DIAGONAL + COORDINATE[i], lane] = W[first + i * NODE_STRIDE + i, lane]
        else:
            size = real(0)
            for j in range(DIMENSION):
                size += abs(W[first + i * NODE_STRIDE + j, lane])
            W[MASS_DIAGONAL + COORDINATE[i], lane] = size
    if PAIRED:
        for k in range(len(PAIRS)):  # [[a, b], [d, a d - b^2]]: one division solves then
            i, j = PAIRS[k, 0], PAIRS[k, 1]
            upper, lower = first + i * NODE_STRIDE, first + j * NODE_STRIDE
            a, b, d = W[upper + i, lane], W[upper + j, lane], W[lower + j, lane]
            W[lower + i, lane] = d
            W[lower + j, lane] = a * d - b**2
    elif DEFINITE:
        factor_symmetric(W, first, DIMENSION, MASS_BAND, NODE_STRIDE, lane)
    else:
        whole = DIMENSION - 1
        factor_rows(W, first, MASS_EXCHANGE, DIMENSION, whole, whole, NODE_STRIDE, lane)
    deficit = real(0)
    if DEFINITE:
        for i in range(DIMENSION):
            pivot = W[first + i * NODE_STRIDE + i, lane]
            deficit += pivot - abs(pivot)
    elif PAIRED:
        for k in range(len(PAIRS)):
            i, j = PAIRS[k, 0], PAIRS[k, 1]
            rows = W[MASS_DIAGONAL + COORDINATE[i], lane] * W[MASS_DIAGONAL + COORDINATE[j], lane]
            pivot = W[first + j * NODE_STRIDE + j, lane]
            deficit = min(deficit, abs(pivot) - SINGULAR * rows)
    else:
        volume = real(1)  # the determinant of M with rows of size 1
        for i in range(DIMENSION):
            pivot = W[first + i * NODE_STRIDE + i, lane]
            volume *= pivot / W[MASS_DIAGONAL + COORDINATE[i], lane]
        deficit = min(deficit, abs(volume) - SINGULAR)
    W[MASS_PIVOT, lane] = deficit


@compiled
def scale_pivots(W, lane):
    """Store 1 / pivot of M at the start of a run."""
    first = HELD if HELD else NODE_L_VV
    for i in range(DIMENSION):
        W[PIVOT_SCALE + i, lane] = 1 / W[first + PIVOT_AT[i], lane]
    if not DEFINITE:
        W[PIVOT_SCALE, lane] *= sign_of_exchanges(W, lane)


@compiled
def least_pivot(W, lane):
    """Return the smallest ratio of a pivot of M to its value at the start.

    If M is indefinite, this is the ratio of the determinants.
    """
    first = HELD if HELD else NODE_L_VV
    least = W[first + PIVOT_AT[0], lane] * W[PIVOT_SCALE, lane]
    for i in range(1, DIMENSION):
        ratio = W[first + PIVOT_AT[i], lane] * W[PIVOT_SCALE + i, lane]
        least = min(least, ratio) if DEFINITE else least * ratio
    if not DEFINITE:
        least *= sign_of_exchanges(W, lane)
    return least


@compiled
def sign_of_exchanges(W, lane):
    """Return the sign of the permutation of the rows of M."""
    sign = real(1)
    for i in range(DIMENSION):
        sign = sign if W[MASS_EXCHANGE + i, lane] == i else -sign
    return sign


@compiled
def solve_with_mass(W, lane):
    """Solve M v = right in place, in the rows of a node's velocity, with the factors of M."""
    first = NODE_L_VV + NODE_OFFSET
    if PAIRED:
        for k in range(len(PAIRS)):
            i, j = PAIRS[k, 0], PAIRS[k, 1]
            upper, lower = first + i * NODE_STRIDE, first + j * NODE_STRIDE
            a, b, d = W[upper + i, lane], W[upper + j, lane], W[lower + i, lane]
            scale = 1 / W[lower + j, lane]
            x, y = W[NODE_VELOCITY + i, lane], W[NODE_VELOCITY + j, lane]
            W[NODE_VELOCITY + i, lane] = scale * (d * x - b * y)
            W[NODE_VELOCITY + j, lane] = scale * (a * y - b * x)
        for k in range(len(ALONE)):
            i = ALONE[k]
            W[NODE_VELOCITY + i, lane] /= W[first + i * NODE_STRIDE + i, lane]
    elif DEFINITE:
        solve_symmetric(W, first, NODE_VELOCITY, DIMENSION, MASS_BAND, NODE_STRIDE, lane)
    else:
        whole, right = DIMENSION - 1, NODE_VELOCITY
        solve_rows(W, first, MASS_EXCHANGE, right, DIMENSION, whole, whole, NODE_STRIDE, lane)


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
