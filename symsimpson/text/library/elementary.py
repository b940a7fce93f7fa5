"""Functions of numbers: sine and cosine without branches, logarithms that do not overflow."""


@compiled
def sincos(x):
    """Sine and cosine without branches, accurate to 2 ulp for |x| < 5e8; NaN beyond."""
    # x = quarter_turns * pi/2 + r with pi/2 in pieces of 24, 24, 24 and 53 bits: the products
    # with the first pieces are exact. Adding and subtracting 1.5 * 2**52 rounds to an integer.
    quarter_turns = (x * 0.6366197723675814 + 6755399441055744.0) - 6755399441055744.0
    # NaN beyond the domain comes in with the last piece, which is ready before the others
    last = quarter_turns * 3.2820035428735005e-22 + (0.0 if abs(x) < 5.0e8 else float("nan"))
    r = (x - quarter_turns * 1.570796251296997) - quarter_turns * 7.549789415861596e-08
    r = (r - quarter_turns * 5.390302529957765e-15) - last
    # minimax polynomials on |r| <= pi/4
    z = r * r
    zz = z * z
    s = (2.7557313691916237e-06 - z * 2.5050758114913125e-08) + zz * 1.5896795630257458e-10
    s = (0.008333333333322413 - z * 0.00019841269829807805) + zz * s
    s = r + r * z * (-0.16666666666666632 + z * s)
    c = (-2.755731435233419e-07 + z * 2.0875723273412855e-09) - zz * 1.1359647812276651e-11
    c = (-0.0013888888888874125 + z * 2.4801587289482188e-05) + zz * c
    c = 1.0 - (0.5 * z - zz * (0.0416666666666666 + z * c))
    # quarter is quarter_turns modulo 4, between -2 and 2
    quarter = (0.25 * quarter_turns + 6755399441055744.0) - 6755399441055744.0
    quarter = quarter_turns - 4.0 * quarter
    odd = abs(quarter) == 1.0
    sine = c if odd else s
    cosine = s if odd else c
    sine = -sine if quarter == -1.0 or abs(quarter) == 2.0 else sine
    cosine = -cosine if quarter >= 1.0 or quarter == -2.0 else cosine
    return sine, cosine


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
