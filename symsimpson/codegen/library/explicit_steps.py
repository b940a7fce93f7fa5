"""Kicks and drifts of an explicit step.

In a time of its own, dt = g(V) dtau, kicks are those of V with g(V), and drifts those of T with
g(E0 - T): both parts of K = f(E0 - V) - f(T), f' = g, solved exactly.
"""


@compiled
def begin_composed(W, lane):
    """Begin with what rounding has left: shears by functions of exact values are symplectic."""
    for a in range(DIMENSION):
        W[INCREMENT + a, lane] = W[POSITION_LOW + a, lane]
        W[RESIDUAL + a, lane] = W[MOMENTUM_LOW + a, lane]
    if RETIMED:
        path_start(W, lane)
        W[PASSED, lane] = real(0)


@compiled
def drift(W, h, node, lane):
    """Move by M^-1 p, from the kick before."""
    for s in range(DIMENSION):
        a = COORDINATE[s]
        W[NODE_VELOCITY + s, lane] = W[MOMENTUM + a, lane] + W[RESIDUAL + a, lane]
    solve_mass(W, lane)
    if RETIMED:
        kinetic = real(0)
        for a in range(DIMENSION):
            p = W[MOMENTUM + a, lane] + W[RESIDUAL + a, lane]
            kinetic += p * W[VELOCITY + a, lane]
        W[ENERGY, lane] = W[PARAMETER + START_ENERGY, lane] - kinetic / 2
        W[RATE, lane] = h * DRIFTS[node - 1]
        own_time(W, lane)
        share = W[RATE, lane]
        W[PASSED, lane] += share
    else:
        share = h * DRIFTS[node - 1]
    move(W, share, node, lane)


@compiled
def move(W, share, node, lane):
    """Move by a share of the velocity."""
    for s in range(DIMENSION):
        a = COORDINATE[s]
        W[INCREMENT + a, lane] += share * W[VELOCITY + a, lane]
        W[NODE_POSITION + s, lane] = W[POSITION + a, lane] + W[INCREMENT + a, lane]
        if TRACED and node == len(DRIFTS):  # the sum that closes the step
            q, _ = exact_sum(W[POSITION + a, lane], W[INCREMENT + a, lane])
            W[NODE_POSITION + s, lane] = q


@compiled
def kick(W, h, node, lane):
    """Change p by a force."""
    if RETIMED:
        W[ENERGY, lane] = real(0)
        potential(W, lane)
        W[RATE, lane] = h * KICKS[node]
        own_time(W, lane)
        share = W[RATE, lane]
    else:
        share = h * KICKS[node]
    for s in range(DIMENSION):
        if FRICTION and DECAYS[COORDINATE[s]] != 0:
            decay(W, share, s, lane)
        else:
            W[RESIDUAL + COORDINATE[s], lane] += share * W[NODE_L_Q + s, lane]


@compiled
def decay(W, share, s, lane):
    """Make exp(-G t) p + (1 - exp(-G t))/G F of p: what friction of the rate G and a force do."""
    a = COORDINATE[s]
    rate = W[DECAY + a, lane]
    half = exp(-rate * share / 2)
    lost = -2 * half * sinh(rate * share / 2)
    p = W[MOMENTUM + a, lane] + W[RESIDUAL + a, lane]
    W[RESIDUAL + a, lane] += lost * p - lost / rate * W[NODE_L_Q + s, lane]


@compiled
def close_composed(W, lane):
    """Close the step; the last force was that at its end."""
    for a in range(DIMENSION):
        add_exactly(W, POSITION + a, POSITION_LOW + a, W[INCREMENT + a, lane], lane)
        add_exactly(W, MOMENTUM + a, MOMENTUM_LOW + a, W[RESIDUAL + a, lane], lane)
