"""The time of the user, of systems whose steps are fixed in a time of their own.

TIME holds t and what rounding has taken from it, then both as they were before the step.
"""


@kernel
def clock(W, h, t, lane):
    """Add the time that the step took."""
    if W[ACTIVE, lane] != 0:
        W[TIME + 2, lane] = W[TIME, lane]
        W[TIME + 3, lane] = W[TIME + 1, lane]
        if not COMPOSED:  # kicks and drifts add up their time themselves
            W[PASSED, lane] = real(0)
            exchange_steps(W, lane)
            for node in range(NODES):
                at_node(W, h, t, node, lane)
                time_rate(W, lane)
                pass_time(W, h, node, lane)
            exchange_steps(W, lane)
        close_time(W, h, lane)


@compiled
def pass_time(W, h, node, lane):
    """Add what a node contributes, dt = g dtau, if time goes on there."""
    rate = W[RATE, lane]
    W[PASSED, lane] += h * WEIGHTS[node] * rate
    if not rate > 0:
        W[STATUS, lane] = 12.0


@compiled
def close_time(W, h, lane):
    """Add the time of the step, by an exact sum of two numbers; the run may have arrived."""
    before = W[TIME, lane]
    step = W[PASSED, lane] + W[TIME + 1, lane]
    after = before + step
    taken = after - before
    rest = after - taken
    W[TIME, lane] = after
    W[TIME + 1, lane] = (before - rest) + (step - taken)
    if not h * W[PASSED, lane] > 0:
        W[STATUS, lane] = 12.0
    over = W[TIME_END, lane] != 0 and h * (after - W[TIME_END + 1, lane]) >= 0
    if over and W[STATUS, lane] == 0:
        W[STATUS, lane] = 11.0
