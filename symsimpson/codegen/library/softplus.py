"""Logarithms of sums of exponentials that do not overflow; log(1 + y) is 2 atanh(y/(2 + y))."""


@compiled
def softplus(x):
    """Return log(1 + exp(x))."""
    small = exp(-abs(x))
    return (x + abs(x)) / 2 + 2 * atanh(small / (2 + small))


@compiled
def logcosh(x):
    """Return log(cosh(x)): near 0 by the tangent of the half angle."""
    size, half = abs(x), tanh(x / 2)
    small = exp(-2 * size)
    far = size + (2 * atanh(small / (2 + small)) - log(real(2)))
    return 2 * atanh(half * half) if size < 1 else far
