"""Sums begin with zero."""


@compiled
def clear_gradient(W, lane):
    """Begin the sum over the terms of L that makes L_q."""
    for s in range(DIMENSION):
        W[NODE_L_Q + s, lane] = real(0)


@compiled
def clear_hessian(W, lane):
    """Begin the sum over the terms of L that makes L_qq."""
    for entry in range(NODE_L_QV - NODE_L_QQ):
        W[NODE_L_QQ + entry, lane] = real(0)


@compiled
def clear_mass(W, lane):
    """Begin the sums over the terms of L that make L_v or a, and L_vv = M."""
    for s in range(DIMENSION):
        W[NODE_L_V + s, lane] = real(0)
    for entry in range(MASS - NODE_L_VV):
        W[NODE_L_VV + entry, lane] = real(0)


@compiled
def clear_gyroscopic(W, lane):
    """Begin the sum over the terms of L that makes a."""
    for s in range(DIMENSION):
        W[NODE_L_V + s, lane] = real(0)


@compiled
def clear_mixed(W, lane):
    """Begin the sum over the terms of L that makes L_qv."""
    for entry in range(NODE_L_VV - NODE_L_QV):
        W[NODE_L_QV + entry, lane] = real(0)


@compiled
def clear_drag(W, lane):
    """Begin with forces that do not depend on v."""
    for entry in range(NODE_L_VV - NODE_L_QV):
        W[NODE_F_V + entry, lane] = real(0)


@compiled
def clear_matrix(W, lane, entries):
    """Begin the sum over nodes that makes a Jacobian."""
    for entry in range(entries):
        W[JACOBIAN + entry, lane] = real(0)


@compiled
def clear_momentum(W, lane):
    """Begin the sum that makes p1 - p0."""
    for a in range(DIMENSION):
        W[RESIDUAL + a, lane] = real(0)
