"""The velocity of a momentum, where L is not quadratic in the velocities; of H, the reverse.

The rows GIVEN have the momenta, and the rows FOUND the velocities. With H(q, p), they are
exchanged: p is sought with H_p = v. Then M is H_pp, and L_v is H_p.
"""


@compiled
def momentum_gap(W, t, lane):
    """Put p - L_v into RESIDUAL, at the velocity at hand; return its squared size.

    SOUGHT has the weights of the momenta, and then their squared size. M is stored in its place.
    """
    go_to_start(W, t, lane)
    mass(W, lane)
    gap, size = real(0), real(0)
    for s in range(DIMENSION):
        a = COORDINATE[s]
        p = W[NODE_L_V + s, lane]
        for b in range(DIMENSION):
            p += W[NODE_L_VV + s * NODE_STRIDE + b + NODE_OFFSET, lane] * W[NODE_VELOCITY + b, lane]
        missing = W[GIVEN + a, lane] - p
        W[RESIDUAL + s, lane] = missing
        gap += W[SOUGHT + s, lane] * missing**2
        size += W[SOUGHT + s, lane] * (p**2 + W[GIVEN + a, lane] ** 2)
    W[SOUGHT + DIMENSION, lane] = size
    return gap


@compiled
def weigh_momenta(W, t, lane):
    """Set the weight of each momentum: 1 over the size of its row of M."""
    go_to_start(W, t, lane)
    mass(W, lane)
    for s in range(DIMENSION):
        size = real(0)
        for b in range(DIMENSION):
            size += abs(W[NODE_L_VV + s * NODE_STRIDE + b + NODE_OFFSET, lane])
        W[SOUGHT + s, lane] = 1 / size


@compiled
def correct_velocity(W, t, gap, lane):
    """Add M^-1 (p - L_v) to the velocity, or a part of it that makes p - L_v smaller.

    Return the new squared size of p - L_v, or the old one if no part made it smaller.
    """
    for s in range(DIMENSION):
        W[NODE_VELOCITY + s, lane] = W[RESIDUAL + s, lane]
        W[SOUGHT + DIMENSION + 1 + s, lane] = W[FOUND + COORDINATE[s], lane]
    small = gap <= CLOSE * W[SOUGHT + DIMENSION, lane]
    factor_mass(W, lane)
    solve_with_mass(W, lane)
    for s in range(DIMENSION):
        W[SOUGHT + 2 * DIMENSION + 1 + s, lane] = W[NODE_VELOCITY + s, lane]
    part = real(1)
    for _ in range(MOST_HALVINGS):
        for s in range(DIMENSION):
            change = part * W[SOUGHT + 2 * DIMENSION + 1 + s, lane]
            W[FOUND + COORDINATE[s], lane] = W[SOUGHT + DIMENSION + 1 + s, lane] + change
        smaller = momentum_gap(W, t, lane)
        if smaller < gap:
            return smaller
        if small:
            break
        part /= 2
    for s in range(DIMENSION):
        W[FOUND + COORDINATE[s], lane] = W[SOUGHT + DIMENSION + 1 + s, lane]
    return gap


@compiled
def invert_momentum(W, t, lane):
    """Find the velocity with L_v(q, v) = p by Newton's method.

    It begins at the velocity at hand, then at 0, then at v = p. The velocity is NaN if all fail.
    """
    for guess in range(3):
        for s in range(DIMENSION):
            a = COORDINATE[s]
            other = W[GIVEN + a, lane] if guess == 2 else real(0)
            W[FOUND + a, lane] = other if guess > 0 else W[FOUND + a, lane]
        weigh_momenta(W, t, lane)
        gap = momentum_gap(W, t, lane)
        for _ in range(MOST_SOUGHT):
            before = gap
            gap = correct_velocity(W, t, gap, lane)
            if not gap < before:
                break
        if gap <= CLOSE * W[SOUGHT + DIMENSION, lane]:
            return
    for a in range(DIMENSION):
        W[FOUND + a, lane] = INFINITE - INFINITE


@compiled
def general_energy(W, t, lane):
    """Begin the energy v.p - L with v.(p - a) - v.M v/2; an error of v enters it squared."""
    go_to_start(W, t, lane)
    mass(W, lane)
    kinetic, moved = real(0), real(0)
    for s in range(DIMENSION):
        v = W[NODE_VELOCITY + s, lane]
        moved += v * (W[MOMENTUM + COORDINATE[s], lane] - W[NODE_L_V + s, lane])
        for b in range(DIMENSION):
            entry = W[NODE_L_VV + s * NODE_STRIDE + b + NODE_OFFSET, lane]
            kinetic += v * entry * W[NODE_VELOCITY + b, lane]
    W[KINETIC, lane] = kinetic / 2
    W[ENERGY, lane] = moved - kinetic / 2
