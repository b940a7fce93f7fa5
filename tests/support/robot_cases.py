"""T, V, M and accelerations of robots at a state, from the equations of motion."""

import numpy as np

from symsimpson.declare.constraints import accelerations
from symsimpson.graph.evaluate import evaluate_doubles


class Dynamics:
    """Values of a system at states; inputs and parameters by name."""

    def __init__(self, system):
        plain, n = system.plain, system.n
        q, v = plain.numbers(plain.q), plain.numbers(plain.v)
        rows = plain.write_constraints(plain.graph)
        terms = accelerations(plain.graph, plain.L, rows, plain.f, (q, v, plain.time))
        self.system, self.plain, self.m = system, plain, len(terms.rows)
        self.wanted = [plain.T, plain.V]
        self.wanted += [plain.entry(i, j) for i in range(n) for j in range(n)]
        self.wanted += [x for row in terms.rows for x in row] + [*terms.push, *terms.curve]

    def at(self, q, v, inputs, parameters):
        """Return T, V, M and the accelerations."""
        plain, n, m = self.plain, self.system.n, self.m
        point = dict(zip(plain.numbers(plain.q), q, strict=True))
        point |= zip(plain.numbers(plain.v), v, strict=True)
        point |= zip(plain.numbers(plain.u), inputs, strict=True)
        point |= zip(plain.numbers(plain.parameters), parameters, strict=True)
        point[plain.time] = 0.0
        numbers = np.array(evaluate_doubles(plain.graph, self.wanted, point))
        M, rest = numbers[2 : 2 + n * n].reshape(n, n), numbers[2 + n * n :]
        W, push, curve = rest[: m * n].reshape(m, n), rest[m * n : m * n + n], rest[m * n + n :]
        whole = np.block([[M, W.T], [W, np.zeros((m, m))]])
        a = np.linalg.solve(whole, np.concatenate([push, -curve]))[:n]
        return numbers[0], numbers[1], M, a


def turned(e, w):
    """Return e o w / 2, the rate of a quaternion."""
    s, x, y, z = e
    left = np.array([[s, -x, -y, -z], [x, s, -z, y], [y, z, s, -x], [z, -y, x, s]])
    return left @ w / 2
