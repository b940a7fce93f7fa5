"""Second derivatives of a step against differences in 60 digits of what T, V and forces say."""

import mpmath as mp
import numpy as np
import pytest
import sympy as sp
from support.cases import sweep
from support.oracle import DIGITS, interpolate, nodes_and_weights

import symsimpson as ss
from symsimpson.errors import InputError

RULES = {
    "simpson": ("lobatto", 3, 2),
    "midpoint": ("gauss", 1, 1),
    "gauss4": ("gauss", 2, 2),
    "lobatto6": ("lobatto", 4, 3),
    "gauss6": ("gauss", 3, 3),
}
H, TIME, STEP = 0.125, 0.5, "1e-11"


def driven():
    (x, theta), u, w = ss.coordinates("x theta"), sp.Symbol("u"), sp.Symbol("w")
    m = sp.Symbol("m", positive=True)
    return ss.MechanicalSystem(
        "driven_arm",
        coordinates=(x, theta),
        kinetic=m * x.diff() ** 2
        + theta.diff() ** 2 / 2
        + x.diff() * theta.diff() * sp.cos(theta) / 2,
        potential=-m * sp.cos(theta) + sp.cos(2 * ss.time) * x**3,
        parameters={m: 1.25},
        inputs=(u, w),
        forces={
            "push": {x: u * sp.cos(theta) + w**2 * u},
            "drag": {theta: -u * theta.diff() ** 3 / 5},
        },
    )


def functions(system):
    """L, f and phi as functions of t, q, v, inputs and parameters, from the declaration alone."""
    n = system.n
    q, v = sp.symbols(f"oq:{n}"), sp.symbols(f"ov:{n}")
    t = sp.Symbol("ot")
    names = {c.diff(): w for c, w in zip(system.coordinates, v, strict=True)}
    names |= dict(zip(system.coordinates, q, strict=True))

    def taken(value):
        return sp.sympify(value).xreplace(names).xreplace({system.coordinates[0].args[0]: t})

    loss = taken(system.dissipation or 0)
    several = [x for x in system.forces.values() if hasattr(x, "get")] or [system.forces]
    f = [
        taken(sum(force.get(c, 0) for force in several)) - sp.diff(loss, w)
        for c, w in zip(system.coordinates, v, strict=True)
    ]
    phi = [taken(value) for value in system.constraints.values()]
    given = (t, q, v, tuple(system.inputs), tuple(system.parameters))
    return [sp.lambdify(given, value, "mpmath") for value in (taken(system.lagrangian), f, phi)]


class Rows:
    """The weighted rows of a step, as a function of control points, multipliers and the rest."""

    def __init__(self, system, scheme, wrt, pick):
        self.system, self.wrt = system, [str(name) for name in wrt]
        quadrature, self.s, self.d = RULES[scheme]
        points = nodes_and_weights("lobatto", self.d + 1)[0]
        nodes, self.b = nodes_and_weights(quadrature, self.s)
        self.tables = [(c, *interpolate(points, c)) for c in nodes]
        self.L, self.f, self.phi = functions(system)
        n, m = system.n, len(system.constraints)
        reference = getattr(system, "reference_state", None) or {"q0": [0.3] * n}
        q0 = np.array(reference["q0"], dtype=float)
        self.X = q0 + 0.1 * pick.normal(size=(self.d + 1, n)) * np.arange(self.d + 1)[:, None]
        self.mu = pick.normal(size=(self.d, m))
        self.u = pick.normal(size=(len(system.inputs), self.s))
        self.weights = pick.normal(size=(self.d + 1, n))
        self.nu = pick.normal(size=(self.d + 1, m))
        self.a = {str(name): value for name, value in system.parameters.items()}

    def known(self, name):
        return {"h": H, "t": TIME}.get(name) or self.a[name]

    def z(self):
        more = []
        for name in self.wrt:
            inputs = [str(u) for u in self.system.inputs]
            more += list(self.u[inputs.index(name)]) if name in inputs else [self.known(name)]
        return [mp.mpf(float(x)) for x in (*self.X.ravel(), *self.mu.ravel(), *more)]

    def value(self, z):
        n, m, d, s = self.system.n, len(self.system.constraints), self.d, self.s
        z = list(z)
        X = [[z.pop(0) for _ in range(n)] for _ in range(d + 1)]
        mu = [[z.pop(0) for _ in range(m)] for _ in range(d)]
        u, a, step = [list(row) for row in self.u], dict(self.a), {"h": mp.mpf(H), "t": TIME}
        for name in self.wrt:
            inputs = [str(one) for one in self.system.inputs]
            if name in inputs:
                u[inputs.index(name)] = [z.pop(0) for _ in range(s)]
            else:
                (step if name in step else a)[name] = z.pop(0)
        a, h, start, tiny = tuple(a.values()), step["h"], step["t"], mp.mpf(STEP)
        weights = [[mp.mpf(float(x)) for x in row] for row in self.weights]

        def along(part):
            """L_d where the path is moved along the weights."""
            moved = [
                [x + part * w for x, w in zip(*pair, strict=True)]
                for pair in zip(X, weights, strict=True)
            ]
            return sum(
                h * b * self.L(start + c * h, *at(moved, A, B), [row[i] for row in u], a)
                for i, (b, (c, A, B)) in enumerate(zip(self.b, self.tables, strict=True))
            )

        def at(points, A, B):
            columns = list(zip(*points, strict=True))
            return [mp.fdot(A, x) for x in columns], [mp.fdot(B, x) / h for x in columns]

        total = (along(tiny) - along(-tiny)) / (2 * tiny)
        for i, (b, (c, A, B)) in enumerate(zip(self.b, self.tables, strict=True)):
            q, v = at(X, A, B)
            force = self.f(start + c * h, q, v, [row[i] for row in u], a)
            for k, share in enumerate(A):
                total += h * b * share * mp.fdot(weights[k], force)

        def phi(points, part, k):
            moved = [x + part * w for x, w in zip(points, weights[k], strict=True)]
            return self.phi(0, moved, [0] * n, [0] * len(u), a)

        for k in range(d + 1) if m else ():
            total += mp.fdot([mp.mpf(float(x)) for x in self.nu[k]], phi(X[k], 0, k))
            if k < d:
                ends = zip(phi(X[k], tiny, k), phi(X[k], -tiny, k), strict=True)
                total -= mp.fdot(mu[k], [(x - y) / (2 * tiny) for x, y in ends])
        return total

    def second(self):
        """Its second derivatives by differences."""
        z, tiny = self.z(), mp.mpf(STEP)
        found = np.zeros((len(z), len(z)))
        for i in range(len(z)):
            for j in range(i + 1):
                total = mp.mpf(0)
                for one in (1, -1):
                    for other in (1, -1):
                        moved = list(z)
                        moved[i] += one * tiny
                        moved[j] += other * tiny
                        total += one * other * self.value(moved)
                found[i, j] = found[j, i] = total / (4 * tiny**2)
        return found


CASES = [
    (driven, "simpson", ("w", "m", "h", "u", "t")),
    (ss.systems.cartesian_pendulum, "simpson", ("g",)),
    (ss.systems.double_pendulum, "gauss4", ("l1",)),
    (ss.systems.cart_pole, "lobatto6", ()),
    (ss.systems.heavy_top, "simpson", ()),
    (ss.systems.van_der_pol, "gauss6", ("mu",)),
    (ss.systems.four_bar, "gauss4", ()),
    (driven, "midpoint", ("u",)),
    (driven, "gauss4", ("h", "u", "t", "m")),
    (ss.systems.cartesian_pendulum, "gauss4", ("h",)),
]


@pytest.mark.plain
@pytest.mark.parametrize(("system", "scheme", "wrt"), sweep(CASES))
def test_they_are_what_the_declaration_says(system, scheme, wrt):
    one = system()
    with mp.workdps(DIGITS):
        rows = Rows(one, scheme, wrt, np.random.default_rng(3))
        wanted = rows.second()
    m = len(one.constraints)
    found = ss.compile(one, scheme).hessian(
        rows.X[0],
        rows.X[1:],
        H,
        rows.weights,
        t=TIME,
        inputs={u: rows.u[k][None] for k, u in enumerate(one.inputs)} or None,
        multipliers=rows.mu if m else None,
        constraint_weights=rows.nu if m else None,
        wrt=wrt,
    )
    assert np.array_equal(found, found.T)
    assert np.abs(found - wanted).max() < 1e-12 * max(1.0, np.abs(wanted).max())


def test_first_derivatives_change_as_they_say():
    """The Jacobian along a line, by a difference, against second derivatives in its rows."""
    stepper = ss.compile(ss.systems.double_pendulum(), "simpson")
    pick = np.random.default_rng(4)
    q0, nodes = np.array([0.5, -0.2]), np.array([[0.55, -0.25], [0.6, -0.3]])
    direction, step = pick.normal(size=(2, 2)), 1e-5
    change = [
        stepper.jacobian(q0, [0, 0], nodes + sign * step * direction, 0.1) for sign in (1, -1)
    ]
    slope = (change[0] - change[1]) / (2 * step)
    for row, (k, a) in enumerate([(1, 0), (1, 1), (0, 0), (0, 1)]):
        weights = np.zeros((3, 2))
        weights[k, a] = 1
        H = stepper.hessian(q0, nodes, 0.1, weights)
        assert H[2:, 2:] @ direction.ravel() == pytest.approx(slope[row], abs=1e-6)


def test_bad_input_is_named():
    stepper = ss.compile(ss.systems.pendulum(), "simpson")
    with pytest.raises(
        InputError, match=r"weights has shape \(2, 1\), but must have shape \(3, 1\)"
    ):
        stepper.hessian([1.0], [[1.0], [1.1]], 0.1, [[1.0], [2.0]])
    with pytest.raises(InputError, match="has no parameter or input"):
        stepper.hessian([1.0], [[1.0], [1.1]], 0.1, [[1.0], [2.0], [0.0]], wrt="u")
    explicit = ss.compile(ss.systems.pendulum(), "blanes_moan4")
    with pytest.raises(InputError, match="explicit"):
        explicit.hessian([1.0], [[1.0]], 0.1, [[1.0], [2.0]])
