"""Systems and numbers of golden files: texts in names that each file declares."""

import sympy as sp

import symsimpson as ss


def read_system(case):
    """Return coordinates, values of parameters, and a reader of texts in their names."""
    q = ss.coordinates(" ".join(case["coordinates"]))
    values = {
        sp.Symbol(name, real=True): float(sp.Rational(x)) for name, x in case["parameters"].items()
    }
    names = {x.func.__name__: x for x in q} | {a.name: a for a in values} | {"t": ss.time}
    names |= {v: x.diff() for v, x in zip(case["velocities"], q, strict=True)}
    return q, values, lambda texts: [sp.sympify(text, locals=names) for text in texts]
