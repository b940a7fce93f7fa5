"""Tables of schemes whose nodes have no closed form, as integers in units of 10**-DIGITS."""


def number(units):
    """Convert units of 10**-DIGITS to the nearest number."""
    return units / 10**DIGITS


def on_grid(units):
    """Convert units of 10**-DIGITS to the nearest x for which 1 - x is exact."""
    return (units * 2**52 + 10**DIGITS // 2) // 10**DIGITS / 2**52


def legendre_p(degree, x):
    """The Legendre polynomials at x of this degree and of the one below."""
    before, now = 0, ONE
    for k in range(1, degree + 1):
        before, now = now, ((2 * k - 1) * x * now // ONE - (k - 1) * before) // k
    return now, before


def zeros(function, count):
    """Zeros between -1 and 1 of the last function of a sequence with interlacing zeros.

    All functions are positive at 1.
    """
    roots = []
    for degree in range(1, count + 1):
        ends = [-ONE, *roots, ONE]
        roots = []
        for place in range(degree):
            low, high = ends[place], ends[place + 1]
            rising = (degree - place) % 2 == 1
            while high - low > 1:
                middle = (low + high) // 2
                if (function(degree, middle) > 0) == rising:
                    high = middle
                else:
                    low = middle
            roots.append(high)
    return roots


def quadrature(kind, nodes):
    """Nodes and weights on [0, 1]."""
    if kind == "gauss":
        roots = zeros(lambda k, x: legendre_p(k, x)[0], nodes)
        # 2/((1 - x^2) P'^2) with (x^2 - 1) P' = n (x P - P_below)
        weights = [(ONE**2 - x * x) * ONE // (nodes * legendre_p(nodes, x)[1]) ** 2 for x in roots]
    else:
        # (x^2 - 1) P' where P' is zero
        roots = zeros(
            lambda k, x: legendre_p(k + 1, x)[1] * ONE - x * legendre_p(k + 1, x)[0], nodes - 2
        )
        roots = [-ONE, *roots, ONE]
        weights = [
            ONE**3 // (nodes * (nodes - 1) * legendre_p(nodes - 1, x)[0] ** 2) for x in roots
        ]
    return [(x + ONE) // 2 for x in roots], weights


def basis(points, x):
    """The Lagrange polynomials of the points at x."""
    values = []
    for point in points:
        value = ONE
        for other in points:
            if other != point:
                value = value * (x - other) // (point - other)
        values.append(value)
    return values


def slopes(points, x):
    """The derivatives of the Lagrange polynomials at x."""
    values = []
    for point in points:
        total = 0
        for leaving in points:
            value = ONE
            for other in points:
                if other not in (point, leaving):
                    value = value * (x - other) // (point - other)
            if leaving != point:
                total += value * ONE // (point - leaving)
        values.append(total)
    return values


def path_tables(kind, nodes, degree, more):
    """Control points, weights, basis and slopes at the nodes, and the extrapolation of the path.

    ``more`` Gauss points of the path follow the nodes.
    """

    def row(values):
        return array([number(value) for value in values])

    def rows(table):
        return array([[number(value) for value in values] for values in table])

    points = quadrature("lobatto", degree + 1)[0]
    c, b = quadrature(kind, nodes)
    c += quadrature("gauss", more)[0]
    ahead = [basis(points, ONE + x) for x in points[1:]]
    return (
        row(points),
        row(c),
        row(b),
        rows(basis(points, x) for x in c),
        rows(slopes(points, x) for x in c),
        rows([*values[1:-1], values[-1] - ONE] for values in ahead),
        row(slopes(points, ONE)[1:]),
        row(points[k + 1] * ahead[k][-1] // ONE for k in range(degree)),
    )


def shares_up_to(c, b, end):
    """The integrals of the Lagrange polynomials up to an end, each divided by its weight."""
    inner = [basis(c, end * x // ONE) for x in c]
    shares = []
    for j in range(len(b)):
        total = sum(b[m] * inner[m][j] for m in range(len(b))) // ONE
        shares.append(end * total // b[j])
    return shares


def stage_table(kind, nodes):
    """Coefficients that sum node velocities and forces to positions, momenta and extrapolations.

    The a_ij are the integrals to c_i of the Lagrange polynomials of the nodes. The table has
    a_ij/b_j for velocities, and 1 - a_ji/b_i for forces: with these the step is symplectic under
    any rounding. Then follow b_i/b_j times the polynomials at 1 + c_i, and the same for their
    smoother parts up to degree s - 3. A column belongs to node i; columns after the last are zero.
    """
    c, b = quadrature(kind, nodes)
    table = array([[real(0)] * STRIDE for _ in range(4 * nodes)])
    velocities, forces, ahead = table[:nodes], table[nodes : 2 * nodes], table[2 * nodes :]
    for i in range(nodes):
        shares = shares_up_to(c, b, c[i])
        following = basis(c, ONE + c[i])
        smooth = [legendre_p(k, 2 * c[i] + ONE)[0] for k in range(max(1, nodes - 2))]
        for j in range(nodes):
            velocities[j, i] = on_grid(shares[j])
            forces[i, j] = real(1) - velocities[j, i]
            ahead[j, i] = number(b[i] * following[j] // b[j])
            terms = [
                (2 * k + 1) * value * legendre_p(k, 2 * c[j] - ONE)[0] // ONE
                for k, value in enumerate(smooth)
            ]
            ahead[nodes + j, i] = number(b[i] * sum(terms) // ONE)
    return table


def reach_table(kind, nodes):
    """Coefficients that sum node displacements to increments: integrals divided by b_j."""
    c, b = quadrature(kind, nodes)
    ends = quadrature("lobatto", nodes + 1)[0][1:]
    return array([[number(share) for share in shares_up_to(c, b, end)] for end in ends])


def end_table(kind, nodes):
    """Coefficients that sum node displacements to the velocity at the end, times h."""
    c, b = quadrature(kind, nodes)
    return array([number(x * ONE // b[j]) for j, x in enumerate(basis(c, ONE))])
