"""Second derivatives of runs: products of the Hessian of a cost with a direction.

With the rows r_k = D_k L_d of a step, its equations are r_1 = ... = r_(d-1) = 0, p_0 + r_0 = 0 and
p_1 = r_d. A cost with the derivatives (a, b) by q_1 and p_1 has the weights w_d = b and

    sum_k w_k dr_k/dX_j + delta_jd a = 0,    j = 1, ..., d.

Its derivatives by q_0, p_0 and parameters are sum_k w_k dr_k/dX_0, w_0 and sum_k w_k dr_k/dtheta.
The derivative of these equations along a direction gives the second derivatives. It contains those
of sum_k w_k r_k at fixed weights. All rows are sums over nodes, so both come from the derivatives
of F = L_q + f and P = L_v at all nodes of all steps.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from symsimpson.errors import reject
from symsimpson.graph.derive import gradient
from symsimpson.graph.point_functions import PointFunctions
from symsimpson.program.program import Program
from symsimpson.stepping.spec import RunSpec
from symsimpson.support.array_types import Floats

#: Most Newton iterations for the control points, and the accepted relative error of q_1 and p_1.
MOST_ITERATIONS, SAME_STEP = 12, 1e-8


def second_derivatives(
    program: Program,
    spec: RunSpec,
    run: Any,
    arguments: Sequence[Any],
    directions: Sequence[Floats],
    jumps: Floats,
) -> tuple[list[Floats], list[Floats]]:
    """Return the derivatives of a cost by the arguments of a run, and their change.

    ``run`` has all states. ``jumps`` has the derivatives of the cost by q and p of each state,
    shape (2, N + 1, n). ``directions`` has a direction for each argument.
    """
    steps = _Steps(program, spec, run, arguments)
    n, varied = program.n, [x for x in arguments if not x.of_state]
    states = {x.kind: v for x, v in zip(arguments, directions, strict=True) if x.of_state}
    changes = [v for x, v in zip(arguments, directions, strict=True) if not x.of_state]
    constant = np.zeros(len(varied))
    theta = np.zeros((spec.steps, len(steps.nodes), len(varied)))
    for j, (argument, change) in enumerate(zip(varied, changes, strict=True)):
        driven = argument.kind == "input"
        theta[..., j] = argument.spread(change) if driven else change
        constant[j] = 0.0 if driven else change
    zero, start = np.zeros(n), None
    dq, dp = states.get("q", zero), states.get("p", zero)
    if spec.velocities:
        start = _Start(steps, spec, dq, states.get("v", zero), constant)
        dp = start.dp
    by_state, by_theta, changed, changed_theta = steps.differentiate(dq, dp, theta, jumps)
    at_start = iter((by_state.ravel(), changed.ravel()))
    if start is not None:
        at_start = iter(start.pull(by_state, changed))
    results = []
    for row, by_node in zip(at_start, (by_theta, changed_theta), strict=True):
        more = row[2 * n :] if start is not None else constant * 0
        parts = []
        for argument in arguments:
            if argument.of_state:
                parts.append(row[:n] if argument.kind == "q" else row[n : 2 * n])
                continue
            j = varied.index(argument)
            slopes = by_node[..., j]
            driven = argument.kind == "input"
            parts.append(argument.gather(slopes) if driven else slopes.sum() + more[j])
        results.append(parts)
    return results[0], results[1]


class _Steps:
    """All steps of a run: their control points, and the derivatives of their rows."""

    def __init__(self, program: Program, spec: RunSpec, run: Any, arguments: Sequence[Any]) -> None:
        plain, tables, n = program.declared.plain, program.method.tables, program.n
        self.plain, self.n, self.h = plain, n, float(spec.h)
        A, B, b, self.nodes = (
            np.array([[float(x) for x in np.ravel(row)] for row in tables[name]])
            for name in ("BASIS", "BASIS_SLOPE", "WEIGHTS", "PLACES")
        )
        b, self.nodes, self.d = b.ravel(), self.nodes.ravel(), A.shape[1] - 1
        #: q at node i is sum_j A_ij X_j, and v is sum_j V_ij X_j.
        self.A, self.V = A, B / self.h
        #: r_k is sum_i a_ik F_i + V_ik c_i P_i.
        self.of_force, self.of_momentum = self.h * b[:, None] * A, self.h * b[:, None] * self.V
        graph, q, v = plain.graph, plain.numbers(plain.q), plain.numbers(plain.v)
        L = plain.L
        forces = [graph.add([x, f]) for x, f in zip(gradient(graph, L, q), plain.f, strict=True)]
        a, u = plain.numbers(plain.parameters), plain.numbers(plain.u)
        varied = [(a if x.kind == "parameter" else u)[x.place] for x in arguments if not x.of_state]
        self.functions = PointFunctions(graph, [*q, *v, *varied], [*forces, *gradient(graph, L, v)])
        inputs = np.broadcast_to(
            spec.inputs[0], (spec.steps, len(self.nodes), spec.inputs.shape[-1])
        )
        times = float(spec.t0) + self.h * (np.arange(spec.steps)[:, None] + self.nodes)
        self.given: dict[int, Any] = dict(zip(a, map(float, spec.parameters), strict=True))
        self.given |= {x: inputs[..., k].ravel() for k, x in enumerate(u)}
        self.given |= dict(zip(plain.numbers([plain.t]), [times.ravel()], strict=True))
        self._solve(program, run)

    def _solve(self, program: Program, run: Any) -> None:
        """Find the control points of all steps by Newton's method from straight lines."""
        N, n, d = run.steps, self.n, self.d
        place = np.linspace(0, 1, d + 1)[:, None]
        self.X = run.q[:-1, None] * (1 - place) + run.q[1:, None] * place
        scale = 1 + np.abs(run.q).max()
        for _ in range(MOST_ITERATIONS):
            rows = self._rows()
            residual = rows[:, :d].copy()
            residual[:, 0] += run.p[:-1]
            change = np.linalg.solve(self.S, -residual.reshape(N, d * n, 1)) if N else residual
            self.X[:, 1:] += change.reshape(N, d, n)
            if np.abs(change).max(initial=0.0) <= 1e-13 * scale:
                break
        ends = np.concatenate([self.X[:, d] - run.q[1:], self._rows()[:, d] - run.p[1:]])
        size = scale + np.abs(run.p).max()
        if not np.abs(ends).max(initial=0.0) <= SAME_STEP * size:
            reject(
                "second derivatives are not available.",
                where=program.system,
                why=f"The steps of {program.scheme} do not solve the equations D_k L_d = 0 of this "
                "system, for example because the scheme integrates damping exactly.",
            )

    def _rows(self) -> Floats:
        """Return the rows r_k at the control points; set their derivatives, and those at nodes."""
        n, N = self.n, len(self.X)
        shape = N, len(self.nodes), n
        q, v = (np.einsum("ij,Njn->Nin", table, self.X) for table in (self.A, self.V))
        columns = np.concatenate([q, v], axis=2).reshape(-1, 2 * n).T
        varied = self.functions.variables[2 * n :]
        self._at = {**self.given, **dict(zip(self.functions.variables, columns, strict=False))}
        count = shape[0] * shape[1]
        values = self.functions.values(self._at, count).T.reshape(*shape[:2], 2 * n)
        slopes = self.functions.jacobian(self._at, count)
        slopes = slopes.reshape(*shape[:2], 2 * n, 2 * n + len(varied))
        forces, momenta = slopes[:, :, :n], slopes[:, :, n:]

        def by_points(table: Floats, at_nodes: Floats) -> Floats:
            by_q = np.einsum("ik,Niab,ij->Nkajb", table, at_nodes[..., :n], self.A)
            by_v = np.einsum("ik,Niab,ij->Nkajb", table, at_nodes[..., n : 2 * n], self.V)
            whole: Floats = by_q + by_v
            return whole

        #: Derivatives of r_k by X_j, shape (N, d + 1, n, d + 1, n), and by parameters at nodes.
        self.D = by_points(self.of_force, forces) + by_points(self.of_momentum, momenta)
        self.D_theta = np.einsum("ik,Niam->Nkaim", self.of_force, forces[..., 2 * n :])
        self.D_theta += np.einsum("ik,Niam->Nkaim", self.of_momentum, momenta[..., 2 * n :])
        size = self.d * n
        self.S = self.D[:, : self.d, :, 1:].reshape(N, size, size)
        rows: Floats = np.einsum("ik,Nin->Nkn", self.of_force, values[..., :n])
        return rows + np.einsum("ik,Nin->Nkn", self.of_momentum, values[..., n:])

    def differentiate(
        self, dq: Floats, dp: Floats, theta: Floats, jumps: Floats
    ) -> tuple[Floats, Floats, Floats, Floats]:
        """Return derivatives of the cost and their change along a direction.

        They are those by (q0, p0), shape (2, n), and by the parameters at the nodes of all steps,
        shape (N, s, m), then the changes of both.
        """
        N, n, d = len(self.X), self.n, self.d
        inverse = np.linalg.inv(self.S) if N else self.S
        right = np.einsum("Nkaim,Nim->Nka", self.D_theta, theta)
        dX = np.zeros((N, d + 1, n))
        for k in range(N):
            rows = np.einsum("kan,n->ka", self.D[k, :, :, 0], dq) + right[k]
            rows[0] += dp
            dX[k, 0] = dq
            dX[k, 1:] = moved = (-inverse[k] @ rows[:d].ravel()).reshape(d, n)
            dp = rows[d] + np.einsum("ajn,jn->a", self.D[k, d, :, 1:], moved)
            dq = moved[-1]
        weights = np.zeros((N, d + 1, n))

        def pull(k: int, more: Floats, state: Floats) -> tuple[Floats, Floats]:
            """Return the weights of a step, and the derivatives by its initial state."""
            w, rows = np.empty((d + 1, n)), more[1:].copy()
            rows[-1] += state[0]
            rows += np.einsum("a,ajn->jn", state[1], self.D[k, d, :, 1:])
            w[:d] = (-inverse[k].T @ rows.ravel()).reshape(d, n)
            w[d] = state[1]
            return w, np.stack([more[0] + np.einsum("ka,kan->n", w, self.D[k, :, :, 0]), w[0]])

        nothing, state = np.zeros((d + 1, n)), jumps[:, N].copy()
        for k in reversed(range(N)):
            weights[k], state = pull(k, nothing, state)
            state += jumps[:, k]
        curved, at_nodes = self._curve(weights, dX, theta)
        changed_weights, changed = np.zeros_like(weights), np.zeros((2, n))
        for k in reversed(range(N)):
            changed_weights[k], changed = pull(k, curved[k], changed)
        by_theta = np.einsum("Nka,Nkaim->Nim", weights, self.D_theta)
        of_theta = at_nodes + np.einsum("Nka,Nkaim->Nim", changed_weights, self.D_theta)
        return state, by_theta, changed, of_theta

    def _curve(self, weights: Floats, dX: Floats, theta: Floats) -> tuple[Floats, Floats]:
        """Return the second derivatives of sum_k w_k r_k along a direction.

        They are those by X_j, shape (N, d + 1, n), and by parameters at nodes, shape (N, s, m).
        """
        n, N = self.n, len(self.X)
        of_rows = [
            np.einsum("ik,Nkn->Nin", table, weights) for table in (self.of_force, self.of_momentum)
        ]
        moved = [np.einsum("ij,Njn->Nin", table, dX) for table in (self.A, self.V)]
        along = np.concatenate([*moved, theta], axis=2).reshape(N * len(self.nodes), -1).T
        at_rows = np.concatenate(of_rows, axis=2).reshape(-1, 2 * n).T
        results = curve(self.functions, self._at, at_rows, along)
        results = results.T.reshape(N, len(self.nodes), -1)
        by_points = np.einsum("ij,Nin->Njn", self.A, results[..., :n])
        by_points += np.einsum("ij,Nin->Njn", self.V, results[..., n : 2 * n])
        return by_points, results[..., 2 * n :]


def curve(functions: PointFunctions, at: Any, weights: Floats, along: Floats) -> Floats:
    """Return the second derivatives of the weighted sum times a direction, at all points."""
    entries = functions.curvatures_at(at, weights, along.shape[1])
    results = np.zeros_like(along)
    for (i, j), entry in zip(functions.curved, entries, strict=True):
        results[i] += entry * along[j]
        if i != j:
            results[j] += entry * along[i]
    return results


class _Start:
    """The initial state of a run that starts with velocities: p0 = L_v(q0, v0)."""

    def __init__(self, steps: _Steps, spec: RunSpec, dq: Floats, dv: Floats, da: Floats) -> None:
        functions, n = steps.functions, steps.n
        self._functions, self._n = functions, n
        state = np.concatenate([spec.q0, spec.other0])
        at = {**steps.given, **dict(zip(functions.variables, state, strict=False))}
        first = {key: x.ravel()[:1] for key, x in at.items() if np.ndim(x)}
        (t,) = steps.plain.numbers([steps.plain.t])
        self._at = at | first | {t: float(spec.t0)}
        self._slopes = functions.jacobian(self._at, 1)[0, n:]
        self._along = np.concatenate([dq, dv, da])[:, None]
        self.dp = self._slopes @ self._along[:, 0]

    def pull(self, state: Floats, changed: Floats) -> tuple[Floats, Floats]:
        """Return derivatives by (q0, v0, parameters) from those by (q0, p0), and their change."""
        weights = np.concatenate([0 * state[1], state[1]])[:, None]
        curved = curve(self._functions, self._at, weights, self._along)[:, 0]
        both = state[1] @ self._slopes, changed[1] @ self._slopes + curved
        for rows, x in zip(both, (state, changed), strict=True):
            rows[: self._n] += x[0]
        return both
