"""The user's time t of retimed systems, whose steps are constant in tau.

TIME has t and its rounding error, then both values before the step.
"""


@kernel
def clock(W, h, t, lane):
    """Add the time of the step, dt = g dtau; stop a run that has arrived, or has dt <= 0."""
    if W[ACTIVE, lane] != 0:
        W[TIME + 2, lane] = W[TIME, lane]
        W[TIME + 3, lane] = W[TIME + 1, lane]
        if not COMPOSED:  # kicks and drifts add up their time themselves
            W[PASSED, lane] = real(0)
            exchange_steps(W, lane)
            for node in range(NODES):
                at_node(W, h, t, node, lane)
                time_rate(W, lane)
                W[PASSED, lane] += h * WEIGHTS[node] * W[RATE, lane]
                if not W[RATE, lane] > 0:
                    W[STATUS, lane] = 12.0
            exchange_steps(W, lane)
        add_exactly(W, TIME, TIME + 1, W[PASSED, lane] + W[TIME + 1, lane], lane)
        if not h * W[PASSED, lane] > 0:
            W[STATUS, lane] = 12.0
        over = W[TIME_END, lane] != 0 and h * (W[TIME, lane] - W[TIME_END + 1, lane]) >= 0
        if over and W[STATUS, lane] == 0:
            W[STATUS, lane] = 11.0
