"""Systems of linear equations, and Newton corrections."""


@compiled
def factor_symmetric(W, first, count, band, stride, lane):
    """Factorise a symmetric matrix L D L^T in its place: L D above the diagonal, L below it."""
    for i in range(count):
        row_i = first + i * stride
        for j in range(max(0, i - band), i):
            row_j = first + j * stride
            entry = W[row_i + j, lane]
            for k in range(max(0, i - band), j):
                entry -= W[first + k * stride + i, lane] * W[row_j + k, lane]
            W[row_j + i, lane] = entry
        for j in range(max(0, i - band), i):
            row_j = first + j * stride
            entry = W[row_j + i, lane] / W[row_j + j, lane]
            W[row_i + j, lane] = entry
            W[row_i + i, lane] -= entry * W[row_j + i, lane]


@compiled
def solve_symmetric(W, first, right, count, band, stride, lane):
    """Solve L D L^T x = b; x replaces b."""
    for i in range(count):
        x = W[right + i, lane]
        for j in range(max(0, i - band), i):
            x -= W[first + i * stride + j, lane] * W[right + j, lane]
        W[right + i, lane] = x
    for back in range(count):
        i = count - 1 - back
        x = W[right + i, lane] / W[first + i * stride + i, lane]
        for j in range(i + 1, min(count, i + band + 1)):
            x -= W[first + j * stride + i, lane] * W[right + j, lane]
        W[right + i, lane] = x


@compiled
def solve_pivoted(W, lane):
    """Solve J x = R in place with row pivoting; each larger entry is swapped in at once."""
    for k in range(SOLVE_UNKNOWNS):
        last = min(SOLVE_UNKNOWNS, k + SOLVE_LOWER + 1)
        end = min(SOLVE_UNKNOWNS, k + SOLVE_UPPER + 1)
        row_k = JACOBIAN + k * SOLVE_STRIDE + SOLVE_OFFSET
        for i in range(k + 1, last):
            row_i = JACOBIAN + i * SOLVE_STRIDE + SOLVE_OFFSET
            if abs(W[row_i + k, lane]) > abs(W[row_k + k, lane]):
                for j in range(k, end):
                    swap = W[row_k + j, lane]
                    W[row_k + j, lane] = W[row_i + j, lane]
                    W[row_i + j, lane] = swap
                swap = W[RESIDUAL + k, lane]
                W[RESIDUAL + k, lane] = W[RESIDUAL + i, lane]
                W[RESIDUAL + i, lane] = swap
        inverse = 1 / W[row_k + k, lane]
        for i in range(k + 1, last):
            row_i = JACOBIAN + i * SOLVE_STRIDE + SOLVE_OFFSET
            factor = W[row_i + k, lane] * inverse
            for j in range(k + 1, end):
                W[row_i + j, lane] -= factor * W[row_k + j, lane]
            W[RESIDUAL + i, lane] -= factor * W[RESIDUAL + k, lane]
    for back in range(SOLVE_UNKNOWNS):
        k = SOLVE_UNKNOWNS - 1 - back
        row_k = JACOBIAN + k * SOLVE_STRIDE + SOLVE_OFFSET
        x = W[RESIDUAL + k, lane]
        for j in range(k + 1, min(SOLVE_UNKNOWNS, k + SOLVE_UPPER + 1)):
            x -= W[row_k + j, lane] * W[RESIDUAL + j, lane]
        W[RESIDUAL + k, lane] = x / W[row_k + k, lane]


@compiled
def solve_in_pairs(W, lane):
    """Solve J x = R in place, by blocks of two rows: each needs one division only."""
    paired = SOLVE_UNKNOWNS - SOLVE_UNKNOWNS % 2
    for k in range(0, paired, 2):
        upper = JACOBIAN + k * SOLVE_STRIDE
        lower = upper + SOLVE_STRIDE
        a, b = W[upper + k, lane], W[upper + k + 1, lane]
        c, d = W[lower + k, lane], W[lower + k + 1, lane]
        scale = 1 / (a * d - b * c)
        W[upper + k, lane], W[upper + k + 1, lane] = d * scale, -b * scale
        W[lower + k, lane], W[lower + k + 1, lane] = -c * scale, a * scale
        for i in range(k + 2, SOLVE_UNKNOWNS):
            row = JACOBIAN + i * SOLVE_STRIDE
            a, b = W[row + k, lane], W[row + k + 1, lane]
            first = a * W[upper + k, lane] + b * W[lower + k, lane]
            second = a * W[upper + k + 1, lane] + b * W[lower + k + 1, lane]
            for j in range(k + 2, SOLVE_UNKNOWNS):
                W[row + j, lane] -= first * W[upper + j, lane] + second * W[lower + j, lane]
            taken = first * W[RESIDUAL + k, lane] + second * W[RESIDUAL + k + 1, lane]
            W[RESIDUAL + i, lane] -= taken
    if paired < SOLVE_UNKNOWNS:
        W[RESIDUAL + paired, lane] /= W[JACOBIAN + paired * SOLVE_STRIDE + paired, lane]
    for back in range(0, paired, 2):
        k = paired - 2 - back
        upper = JACOBIAN + k * SOLVE_STRIDE
        lower = upper + SOLVE_STRIDE
        x, y = W[RESIDUAL + k, lane], W[RESIDUAL + k + 1, lane]
        for j in range(k + 2, SOLVE_UNKNOWNS):
            x -= W[upper + j, lane] * W[RESIDUAL + j, lane]
            y -= W[lower + j, lane] * W[RESIDUAL + j, lane]
        W[RESIDUAL + k, lane] = W[upper + k, lane] * x + W[upper + k + 1, lane] * y
        W[RESIDUAL + k + 1, lane] = W[lower + k, lane] * x + W[lower + k + 1, lane] * y


@compiled
def update_increments(W, lane):
    """Apply the Newton correction; measure it and the increments by the diagonal of M(q0)."""
    correction_squared = real(0)
    increment_squared = real(0)
    for s in range(SOLVE_COORDINATES):
        a = COORDINATE[s]
        correction = real(0)
        increment = real(0)
        for row in range(BLOCKS):
            unknown = INCREMENT + (SOLVE_COLUMNS[row] - 1) * DIMENSION + a
            change = -W[RESIDUAL + row * SOLVE_ROW_STEP + s * SOLVE_PLACE_STEP, lane]
            new = W[unknown, lane] + change
            W[unknown, lane] = new
            correction += W[MASS_DIAGONAL + a, lane] * change**2
            increment += W[MASS_DIAGONAL + a, lane] * new**2
        if FOLLOWS:
            unknown = INCREMENT + (DEGREE - 1) * DIMENSION + a
            change = W[RESIDUAL + BLOCKS * DIMENSION + s, lane]
            new = W[unknown, lane] + change
            W[unknown, lane] = new
            correction += W[MASS_DIAGONAL + a, lane] * change**2
            increment += W[MASS_DIAGONAL + a, lane] * new**2
        W[OWN_CORRECTION + a, lane] = correction
        W[OWN_INCREMENT + a, lane] = increment
        correction_squared += correction
        increment_squared += increment
    W[CORRECTION_SQUARED, lane] = correction_squared
    W[INCREMENT_SQUARED, lane] = increment_squared
    if HELD:  # multipliers follow where the increments go
        for row in range(DEGREE * DIMENSION, DEGREE * (DIMENSION + CONSTRAINTS)):
            W[INCREMENT + row, lane] -= W[RESIDUAL + row, lane]


@compiled
def solve_following(W, h, t, lane):
    """Solve for coordinates that follow from the others, whose increments stay constant."""
    step_equations(W, h, t, lane)
    for row in range(BLOCKS):
        for s in range(SOLVE_COORDINATES):
            i = row * SOLVE_ROW_STEP + s * SOLVE_PLACE_STEP
            if FOLLOWING[s] == 0:
                W[RESIDUAL + i, lane] = real(0)
                for j in range(SOLVE_UNKNOWNS):
                    entry = JACOBIAN + i * SOLVE_STRIDE + SOLVE_OFFSET + j
                    W[entry, lane] = real(1) if i == j else real(0)
    solve_pivoted(W, lane)
    update_increments(W, lane)


@compiled
def factor_equations(W, lane):
    """Factorise the matrix of all unknowns, P S = L U, in its place; EXCHANGE has P."""
    if HELD:
        join_equations(W, lane)
    first, count, stride = JACOBIAN + TANGENT_OFFSET, TANGENT_UNKNOWNS, TANGENT_STRIDE
    factor_rows(W, first, EXCHANGE, count, TANGENT_LOWER, TANGENT_UPPER, stride, lane)


@compiled
def factor_rows(W, first, exchanges, count, lower, upper, stride, lane):
    """Factorise P A = L U in place, with the larger pivots first; ``exchanges`` has P."""
    for k in range(count):
        last = min(count, k + lower + 1)
        end = min(count, k + upper + 1)
        row_k = first + k * stride
        pivot = k
        largest = abs(W[row_k + k, lane])
        for i in range(k + 1, last):
            here = abs(W[first + i * stride + k, lane])
            if here > largest:
                largest = here
                pivot = i
        W[exchanges + k, lane] = pivot
        if pivot != k:
            exchange(W, row_k + k, first + pivot * stride + k, end - k, lane)
        inverse = 1 / W[row_k + k, lane]
        for i in range(k + 1, last):
            row_i = first + i * stride
            factor = W[row_i + k, lane] * inverse
            W[row_i + k, lane] = factor
            for j in range(k + 1, end):
                W[row_i + j, lane] -= factor * W[row_k + j, lane]


@compiled
def factor_in_order(W, first, count, stride, lane):
    """Factorise A = L U in place, dense and without exchanges; U has inverse pivots."""
    for k in range(count):
        row_k = first + k * stride
        inverse = 1 / W[row_k + k, lane]
        W[row_k + k, lane] = inverse
        for i in range(k + 1, count):
            row_i = first + i * stride
            factor = W[row_i + k, lane] * inverse
            W[row_i + k, lane] = factor
            for j in range(k + 1, count):
                W[row_i + j, lane] -= factor * W[row_k + j, lane]


@compiled
def solve_in_order(W, first, right, count, stride, lane):
    """Solve A x = b with these factors; x replaces b."""
    for i in range(count):
        x = W[right + i, lane]
        for k in range(i):
            x -= W[first + i * stride + k, lane] * W[right + k, lane]
        W[right + i, lane] = x
    for back in range(count):
        k = count - 1 - back
        x = W[right + k, lane]
        for j in range(k + 1, count):
            x -= W[first + k * stride + j, lane] * W[right + j, lane]
        W[right + k, lane] = x * W[first + k * stride + k, lane]


@compiled
def solve_factored(W, right, lane):
    """Solve S x = b with these factors; x replaces b."""
    if HELD:
        reorder_rows(W, right, 0, lane)
    first, count, stride = JACOBIAN + TANGENT_OFFSET, TANGENT_UNKNOWNS, TANGENT_STRIDE
    solve_rows(W, first, EXCHANGE, right, count, TANGENT_LOWER, TANGENT_UPPER, stride, lane)
    if HELD:
        reorder_rows(W, right, 1, lane)


@compiled
def solve_rows(W, first, exchanges, right, count, lower, upper, stride, lane):
    """Solve A x = b with the factors of P A = L U; x replaces b."""
    for k in range(count):
        pivot = int(W[exchanges + k, lane])
        x = W[right + pivot, lane]
        W[right + pivot, lane] = W[right + k, lane]
        W[right + k, lane] = x
        for i in range(k + 1, min(count, k + lower + 1)):
            W[right + i, lane] -= W[first + i * stride + k, lane] * x
    for back in range(count):
        k = count - 1 - back
        row_k = first + k * stride
        x = W[right + k, lane]
        for j in range(k + 1, min(count, k + upper + 1)):
            x -= W[row_k + j, lane] * W[right + j, lane]
        W[right + k, lane] = x / W[row_k + k, lane]


@compiled
def solve_transposed(W, right, lane):
    """Solve S^T x = b with these factors; x replaces b."""
    if HELD:
        reorder_rows(W, right, 0, lane)
    first = JACOBIAN + TANGENT_OFFSET
    for k in range(TANGENT_UNKNOWNS):
        x = W[right + k, lane] / W[first + k * TANGENT_STRIDE + k, lane]
        W[right + k, lane] = x
        for j in range(k + 1, min(TANGENT_UNKNOWNS, k + TANGENT_UPPER + 1)):
            W[right + j, lane] -= W[first + k * TANGENT_STRIDE + j, lane] * x
    for back in range(TANGENT_UNKNOWNS):
        k = TANGENT_UNKNOWNS - 1 - back
        x = W[right + k, lane]
        for i in range(k + 1, min(TANGENT_UNKNOWNS, k + TANGENT_LOWER + 1)):
            x -= W[first + i * TANGENT_STRIDE + k, lane] * W[right + i, lane]
        pivot = int(W[EXCHANGE + k, lane])
        W[right + k, lane] = W[right + pivot, lane]
        W[right + pivot, lane] = x
    if HELD:
        reorder_rows(W, right, 1, lane)
