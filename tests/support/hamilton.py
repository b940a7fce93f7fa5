"""Where Hamilton's equations lead, by an explicit Runge-Kutta method of order eight."""

from scipy.integrate import solve_ivp

from symsimpson.reference import canonical


def truth(system, q, p, end):
    """The state (q, p) at the time ``end``, from one at t = 0; forces are those of the system."""
    rates = canonical(system).function("math")
    start = [*q, *p] + ([] if system.plain.autonomous else [0.0])
    found = solve_ivp(
        lambda _, y: rates(*y, *system.parameters.values()),
        (0, end),
        start,
        method="DOP853",
        rtol=3e-14,
        atol=1e-15,
    )
    return found.y[: 2 * system.n, -1]
