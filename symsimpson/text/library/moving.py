"""Rows of the workspace are cleared, copied, exchanged and scaled."""


@compiled
def clear(W, first, count, lane):
    """Set rows to zero."""
    for k in range(count):
        W[first + k, lane] = real(0)


@compiled
def copy(W, source, target, count, lane):
    """Copy rows."""
    for k in range(count):
        W[target + k, lane] = W[source + k, lane]


@compiled
def exchange(W, first, second, count, lane):
    """Exchange rows."""
    for k in range(count):
        kept = W[first + k, lane]
        W[first + k, lane] = W[second + k, lane]
        W[second + k, lane] = kept


@compiled
def multiply(W, first, count, factor, lane):
    """Multiply rows by a factor."""
    for k in range(count):
        W[first + k, lane] *= factor
