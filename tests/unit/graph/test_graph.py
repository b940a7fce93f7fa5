"""Nodes, derivatives and programs stand for the expressions that they were made of."""

from fractions import Fraction

import mpmath as mp
import pytest
import sympy as sp

from symsimpson.graph import lines, nodes
from symsimpson.graph.derive import Derivatives, gradient
from symsimpson.graph.evaluate import evaluate_line, evaluate_nodes, moduli
from symsimpson.graph.findings import IdentityTest, merge_equal_nodes
from symsimpson.graph.lines import StraightLineCode
from symsimpson.graph.nodes import Graph
from symsimpson.graph.read import SympyConverter, to_sympy, tree_size
from symsimpson.graph.rebuild import agree_at_points, fix_symbols, rebuild
from symsimpson.graph.roots import Signs, dependent_radicands
from symsimpson.graph.share import share

x, y, z = sp.symbols("x y z", real=True)
a = sp.Symbol("a", positive=True)
SYMBOLS = (x, y, z, a)
EXPRESSIONS = [
    (x + y) ** 2 * sp.sin(x * y) / (1 + z**2),
    a * sp.sqrt(x**2 + y**2) ** -3 + sp.Float(0.1) * x**5 / a,
    sp.tan(x / 2) + sp.sec(y) * sp.cot(z) + sp.csc(z + x),
    sp.exp(-x * y) * sp.log(a + x**2) + sp.cosh(y) * sp.sinh(z) / sp.tanh(a),
    sp.asin(x / 9) + sp.acos(y / 9) * sp.atan(z) + sp.atan2(y, 2 + x**2),
    sp.asinh(x) + sp.acosh(2 + y**2) - sp.atanh(z / 9),
    sp.erf(x) * sp.erfc(y) + sp.pi * x - sp.E * y + sp.EulerGamma * z,
    x ** sp.Rational(1, 3) + (2 * x) ** 1.5 + (1 + x) ** a + x**0.1,
    sp.sqrt(-4 * -x) + sp.sqrt(8 * y) + sp.GoldenRatio * z,
    sum((x - k) ** -6 - (y + k) ** -12 for k in range(2, 5)),
]


GROWING = [
    sp.log(sp.cosh(a * x)),
    sp.log(2 * sp.cosh(x)),
    sp.log(1 + sp.exp(x)),
    sp.log(1 + sp.exp(-a * x)),
    sp.log(sp.exp(x) + sp.exp(-2 * x)),
    sp.log(a * sp.exp(x) + 3 * sp.exp(-x) + a),
    sp.log(1 + sp.cosh(x)) / a,
    sp.log(sp.exp(x) * sp.cosh(x)),
    sp.log(sp.sinh(x)),
    sp.log(sp.sinh(x) ** 2 * a),
    sp.log(x**2 * sp.cosh(x)),
    sp.log((1 + a) * sp.exp(x) + 1) / 2 + sp.log(1 / sp.cosh(x)),
    sp.sinh(x) / sp.cosh(x),
]


@pytest.mark.parametrize("expression", GROWING, ids=str)
def test_logarithms_and_quotients_of_exponentials_do_not_overflow(expression):
    """Values and three derivatives, where the exponentials are numbers and where they are none."""
    one_sided = sp.log(sp.sinh(x))
    graph, (value,), places = read(expression)
    shown = to_sympy(graph, value, {n: s for s, n in places.items()})
    assert agree_at_points(
        graph, value, SympyConverter(graph, {s: (1, n) for s, n in places.items()})(shown)
    )
    derivatives = Derivatives(graph)
    for order in range(4):
        right = sp.lambdify(
            (x, a), sp.diff(expression, x, order) if order else expression, "mpmath"
        )
        for at in (-900.0, -30.0, -0.4, 0.4, 30.0, 900.0)[3 * (expression == one_sided) :]:
            doubles = evaluate_nodes(graph, [value[1]], {places[x]: at, places[a]: 1.25}, mp.fp)
            found = float(value[0]) * doubles[value[1]]
            with mp.workdps(820):
                exact = right(mp.mpf(at), mp.mpf(1.25))
            assert abs(found - exact) <= 1e-14 * (1 + abs(exact)) + 2e-16 * abs(at), (order, at)
        value = derivatives(value, places[x])


@pytest.mark.parametrize("at", [-700.0, -60.0, -3.0])
def test_what_is_left_of_an_exponential_is_not_lost(at):
    graph, (value,), places = read(sp.log(1 + sp.exp(x)))
    for _ in range(3):
        found = evaluate_nodes(graph, [value[1]], {places[x]: at}, mp.fp)[value[1]]
        assert abs(found * float(value[0]) / mp.exp(at) - 1) < (1e-12 if at < -30 else 0.2)
        value = Derivatives(graph)(value, places[x])


@pytest.mark.parametrize(
    "expression", [sp.log(x + sp.exp(y)), sp.log(1 - sp.exp(x)), sp.log(a * x * (1 + y))]
)
def test_other_logarithms_stay(expression):
    graph, (value,), _ = read(expression)
    assert graph.nodes[value[1]].parts[0] == "log"


def read(*expressions, factored=False):
    graph = Graph(factored=factored)
    known = {s: graph.symbol(s.name) for s in SYMBOLS}
    reader = SympyConverter(graph, known)
    return graph, [reader(e) for e in expressions], {s: n for s, (_, n) in known.items()}


def point(places):
    return {n: mp.mpf(3 + k) / 7 for k, n in enumerate(places.values())}


def number(value, numbers):
    c, n = value
    return mp.mpf(c.numerator) / c.denominator * numbers[n]


def truth(expression, places):
    at = {s: sp.Rational(3 + k, 7) for k, s in enumerate(places)}
    return mp.mpf(sp.N(expression.subs(at), 50))


@pytest.mark.parametrize("expression", EXPRESSIONS)
@pytest.mark.parametrize("factored", [False, True])
def test_values_and_derivatives(expression, factored):
    graph, (value,), places = read(expression, factored=factored)
    derivatives = Derivatives(graph)
    forward = {s: derivatives(value, n) for s, n in places.items()}
    reverse = dict(zip(places, gradient(graph, value, list(places.values())), strict=True))
    with mp.workdps(50):
        roots = [value, *forward.values(), *reverse.values()]
        numbers = evaluate_nodes(graph, [n for _, n in roots], point(places), mp.mp)
        exact = expression.xreplace({f: sp.nsimplify(f) for f in expression.atoms(sp.Float)})
        if not expression.has(sp.Float):
            assert abs(number(value, numbers) - truth(exact, places)) < 1e-45
        for s in SYMBOLS:
            slope = truth(expression.diff(s), places)
            tolerance = 1e-14 if expression.has(sp.Float) else 1e-43
            assert abs(number(forward[s], numbers) - slope) < tolerance * (1 + abs(slope))
            assert abs(number(reverse[s], numbers) - slope) < tolerance * (1 + abs(slope))


@pytest.mark.parametrize("expression", EXPRESSIONS)
def test_written_expressions_are_read_again(expression):
    graph, (value,), places = read(expression)
    text = to_sympy(graph, value, {n: s for s, n in places.items()})
    assert SympyConverter(graph, {s: (1, n) for s, n in places.items()})(text) == value


@pytest.mark.parametrize("factored", [False, True])
def test_programs_keep_the_values(factored):
    graph, values, places = read(*EXPRESSIONS, factored=factored)
    derivatives = Derivatives(graph)
    values += [derivatives(value, n) for value in values for n in places.values()]

    def level(n):
        symbols = graph.nodes[n].symbols
        return 2 if places[z] in symbols else 1 if symbols - {places[a]} else 0

    with mp.workdps(50):
        before = evaluate_nodes(graph, [n for _, n in values], point(places), mp.mp)
        equal = merge_equal_nodes(graph, values, level)
        program = StraightLineCode.of(graph, dict(enumerate(equal)), level)
        count = program.operations()
        share(program)
        assert program.operations() < count
        after = point(places)
        for n in program.order():
            line = program.lines[n]
            if line.kind != "symbol":
                after[n] = evaluate_line(line.kind, line.parts, after, mp.mp)
                levels = [program.lines[m].level for m in program.arguments(n)]
                assert line.level == max(levels, default=0)
        for k, value in enumerate(values):
            exact = number(value, before)
            assert abs(number(program.outputs[k], after) - exact) < 1e-40 * (1 + abs(exact))


def test_equal_nodes_are_one():
    root = sp.sqrt(x**2 + y**2)
    graph, values, _ = read(
        (sp.sin(x) ** 2 + sp.cos(x) ** 2) * y, root - x**2 / root, y**2 / root, x - y, (y - x) ** 3
    )
    one, first, second, third, power = merge_equal_nodes(graph, values, lambda n: 0)
    assert one == (1, graph.symbol("y")[1])
    assert first == second
    assert graph.nodes[power[1]].parts == ((third[1], 3),)


def test_the_square_of_lennard_and_jones_takes_few_powers():
    r = sp.symbols("r0:6", real=True)
    square = sum((r[i] - r[i + 3]) ** 2 for i in range(3))
    graph = Graph(factored=True)
    known = {s: graph.symbol(s.name) for s in (*r, a)}
    value = SympyConverter(graph, known)(4 * a * (square**-6 - square**-3))
    derivatives = Derivatives(graph)
    slopes = [derivatives(value, known[s][1]) for s in r]
    every = slopes + [derivatives(slope, known[s][1]) for slope in slopes for s in r]
    program = StraightLineCode.of(
        graph, dict(enumerate(every)), lambda n: int(n > 0 and n != known[a][1])
    )
    share(program)
    divisions = [
        p
        for n in program.order()
        for p in [program.lines[n]]
        if p.kind == "product" and any(e < 0 for _, e in p.parts)
    ]
    assert len(divisions) == 1
    assert program.operations() < 60


def test_nothing_is_expanded():
    """A product of twenty sums of sums is a hundred nodes, and a tree of a million."""
    total = x
    for _ in range(20):
        total = total * (total + y)
    graph, (value,), _ = read(total)
    assert len(graph.nodes) < 100
    assert tree_size(graph, value) > 10**6


def test_fixing_avoids_poles():
    graph, (value,), places = read(y + x / x**2 * x)
    assert graph.nodes[value[1]].symbols == {places[y]}
    graph, (value,), places = read(y + (x + x**2) / (1 + x) / x)
    assert rebuild(graph, [fix_symbols(graph, value, [places[x]])], {places[y]: (0, 0)}) == [(1, 0)]


def test_several_symbols_are_fixed_at_a_time_or_one_by_one():
    graph, (value,), places = read(y + (x + x**2) / (1 + x) / x + (z + z**2) / (1 + z) - z)
    without = fix_symbols(graph, value, [places[x], places[z]])
    assert graph.nodes[without[1]].symbols == {places[y]}
    assert rebuild(graph, [without], {places[y]: (0, 0)}) == [(1, 0)]
    assert fix_symbols(graph, value, [places[x], places[y]]) is None
    assert fix_symbols(graph, value, []) == value


def test_floats_are_exact():
    _, values, _ = read(sp.Float(0.1) * x + sp.Float(0.2) * x, sp.Float(0.3) * x)
    assert values[0] != values[1]
    _, values, _ = read(sp.Float(0.1) * x + sp.Float(0.2) * x, sp.Float(0.1 + 0.2) * x)
    assert abs(float(values[0][0]) - 0.3) < 1e-15


def diamond(depth):
    """Return x_depth of x_{k+1} = sqrt(1 + sin(x_k)^2) cos(x_k) + (x_k + y): many paths down."""
    graph = Graph()
    value, other = graph.symbol("x"), graph.symbol("y")
    for _ in range(depth):
        root = graph.power(
            graph.add([(1, 0), graph.power(graph.function("sin", value), 2)]), Fraction(1, 2)
        )
        product = graph.multiply([root, graph.function("cos", value)])
        value = graph.add([product, (1, graph.absorb_coefficient(graph.add([value, other])))])
    return graph, value


WALKS = {
    "reached": lambda g, v: g.descendants([v[1]]),
    "Derivatives": lambda g, v: Derivatives(g)(v, g.symbol("x")[1]),
    "gradient": lambda g, v: gradient(g, v, g.numbers("xy")),
    "evaluated": lambda g, v: evaluate_nodes(g, [v[1]], dict.fromkeys(g.numbers("xy"), 0.5), mp.fp),
    "moduli": lambda g, v: moduli(
        g, [v[1]], evaluate_nodes(g, [v[1]], dict.fromkeys(g.numbers("xy"), 0.5), mp.fp)
    ),
    "findings": lambda g, v: IdentityTest(g, [v]),
    "merged": lambda g, v: merge_equal_nodes(g, [v], lambda n: 0),
    "rebuilt": lambda g, v: rebuild(g, [v], {g.symbol("x")[1]: g.symbol("z")}),
    "fixed": lambda g, v: fix_symbols(g, v, g.numbers("x")),
    "same": lambda g, v: agree_at_points(g, v, v),
    "radicands": lambda g, v: dependent_radicands(g, [v[1]]),
    "tree_size": tree_size,
    "signs": lambda g, v: (Signs(g, {})(v), Signs(g, {}).never_real(v[1])),
    "share": lambda g, v: share(StraightLineCode.of(g, {"value": v}, lambda n: 0)),
}


@pytest.mark.parametrize("walk", WALKS)
def test_shared_nodes_are_visited_once_and_not_on_every_path(walk, monkeypatch):
    """Each of 100 levels is reached twice from the one above it: on 2^100 paths in all."""
    graph, value = diamond(100)
    size, visits = len(graph.nodes), [0]
    look = nodes.arguments

    def counted(*given):
        visits[0] += 1
        # linear walks take 13 at most, at any depth; quadratic ones take 45 and more
        assert visits[0] < 20 * size
        return look(*given)

    monkeypatch.setattr(nodes, "arguments", counted)
    monkeypatch.setattr(lines, "arguments", counted, raising=False)
    WALKS[walk](graph, value)
