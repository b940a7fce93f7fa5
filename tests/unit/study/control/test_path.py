"""Rows that are asked for all along the path."""

import pytest
import sympy as sp

import symsimpson as ss

pytest.importorskip("casadi")


def test_relations_on_the_path_are_rows():
    a, b = ss.coordinates("a b")
    f, g = sp.symbols("f g", real=True)
    flat = ss.MechanicalSystem(
        "plane",
        coordinates=(a, b),
        kinetic=(a.diff() ** 2 + b.diff() ** 2) / 2,
        potential=0,
        forces={a: f, b: g},
        inputs=(f, g),
    )
    rest = {a.diff(): 0, b.diff(): 0}

    def solved(*path, **bounds):
        return ss.OptimalControl(
            flat,
            cost=f**2 + g**2,
            start={a: 0, b: 0} | rest,
            end={a: 1, b: 1} | rest,
            duration=1,
            path=path,
            **bounds,
        ).solve(steps=6)

    on_curve = solved((0, b - a**2, 0))
    free = solved()
    assert on_curve.cost > free.cost + 1
    # an equation, and two relations that make one: independent rows, and the same problem
    for path in ([sp.Eq(b, a**2)], [b <= a**2, a**2 <= b], [b - a**2, a**2 - b]):
        same = solved(*path)
        assert same.status is ss.ControlStatus.SOLVED
        assert abs(same.cost - on_curve.cost) < 1e-9
    strict = solved(b < a**2, a**2 < b)
    assert abs(strict.cost - on_curve.cost) < 1e-9
    above = solved(b >= a**2 + a / 2 - sp.Rational(1, 2))
    assert above.status is ss.ControlStatus.SOLVED
    assert (above.q[:, 1] >= above.q[:, 0] ** 2 + above.q[:, 0] / 2 - 0.5 - 1e-9).all()

    for entry in (sp.And(a < 2, a > -2), sp.Ne(a, 2), sp.true, (-1, sp.Eq(a, b), 1)):
        with pytest.raises(ss.InputError, match="which is not an expression or a single relation"):
            solved(entry)
