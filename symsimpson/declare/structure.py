"""Structure of a system: granted by algebra, or by an identity test in a finite field.

Forces F = L_q + f and momenta P = L_v are asked what moves them; the error of an answer is below
2^-100 (:mod:`symsimpson.graph.field`). What a field leaves open, 60 digits may refuse or SymPy may
grant; the rest is undecided, which counts as not there.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction

from symsimpson.declare.declared import Declared
from symsimpson.declare.identities import Dependence, Samples, certain
from symsimpson.declare.plain import Plain
from symsimpson.declare.quadratic import connected, quadratic_form
from symsimpson.graph.derive import Derivatives, gradient
from symsimpson.graph.findings import Findings
from symsimpson.graph.nodes import ZERO, Graph, Value, scaled
from symsimpson.graph.rebuild import NUMBERS, fixed, rebuilt, same

#: Linear equations of more unknowns than this are iterated as others are.
MOST_AFFINE = 16


def damping_rate(plain: Plain) -> Value | None:
    """Return gamma where the forces are f = -2 gamma L_v, gamma made of parameters; else None.

    The motion is then that of the Lagrangian e^(2 gamma t) L (R. McLachlan and M. Perlmutter,
    J. Geom. Phys. 39 (2001) 276).
    """
    graph, v = plain.graph, plain.numbers(plain.v)
    if not all(c for c, _ in plain.f):
        return None
    mass = plain.entry(0, 0)
    slope = Derivatives(graph)(plain.f[0], v[0])
    if not slope[0]:
        return None
    rate = scaled(-1, graph.multiply([slope, (1, graph.kept((2 * mass[0], mass[1])), -1)]))
    momenta = gradient(graph, plain.L, v)
    pairs = zip(plain.f, momenta, strict=True)
    left = [graph.add([f, graph.multiply([(2, 0), rate, p])]) for f, p in pairs]
    findings = Findings(graph, [rate, *left])
    if not all(map(findings.vanishes, left)):
        return None
    moving = plain.numbers((*plain.q, *plain.v, *plain.u, plain.t))
    present = graph.nodes[rate[1]].symbols.intersection(moving)
    if any(findings.depends(rate, x) for x in present):
        return None
    return fixed(graph, rate, present) if present else rate


def decay_rates(plain: Plain) -> tuple[Value, ...] | None:
    """Return Gamma_i where forces are f_i = g_i(t, q, u) - Gamma_i (M v)_i; else None.

    M must be constant. The rates are made of parameters, each zero or known to be positive; where
    all are alike they are twice the gamma of :func:`damping_rate`.
    """
    graph, v = plain.graph, plain.numbers(plain.v)
    n, derivatives = len(v), Derivatives(graph)
    slopes = [[derivatives(f, x) for x in v] for f in plain.f]
    rates = []
    for i in range(n):
        slope, inverse = slopes[i][i], (1, graph.kept(plain.entry(i, i)), -1)
        rates.append(scaled(-1, graph.multiply([slope, inverse])) if slope[0] else ZERO)
    moving = set(plain.numbers((*plain.q, *plain.v, *plain.u, plain.t)))
    if any(not graph.nodes[k].symbols.isdisjoint(moving) for _, k in rates):
        return None
    left = [
        graph.add([slopes[i][j], graph.multiply([rates[i], plain.entry(i, j)])])
        for i in range(n)
        for j in range(n)
    ]
    findings = Findings(graph, left)
    if not all(map(findings.vanishes, left)):
        return None
    known = all(not rate[0] or plain.signs(rate) == (1, True) for rate in rates)
    return tuple(rates) if known else None


@dataclass(frozen=True)
class Subsystem:
    """Coordinates that move by themselves, by their places in the system.

    Attributes
    ----------
    coordinates : tuple of int
        Those of the subsystem.
    cyclic : tuple of int
        Those among them that neither L nor a force depends on, and on which no force acts.
    constant_mass : bool
        Its block of M depends neither on q nor on t.
    separable : bool
        L = T(v) - V(t, q): M is constant, there are no terms linear in v, and no force depends
        on v.
    linear : bool
        Separable, without t, and V is quadratic and the only force: it is linear in q.
    affine : bool
        Forces act, or t stands there; M is constant, and forces and momenta are affine in q and v,
        with coefficients of parameters alone.
    """

    coordinates: tuple[int, ...]
    cyclic: tuple[int, ...]
    constant_mass: bool
    separable: bool
    linear: bool
    affine: bool = False


@dataclass(frozen=True, repr=False)
class Structure:
    """Findings about a system; each holds for every value of q and of the parameters.

    Attributes
    ----------
    n : int
        Number of coordinates.
    constant_mass, diagonal_mass : bool
        M depends neither on q nor on t; M has no entries off its diagonal.
    constant_rows : tuple of str
        Coordinates whose whole row of M does not depend on q.
    gyroscopic : bool
        L has terms linear in the velocities.
    separable, linear : bool
        L = T(v) - V(q), and V is quadratic beyond that.
    cyclic : tuple of str
        Coordinates that neither L nor a force depends on, and on which no force acts: their
        momenta are constant.
    autonomous : bool
        Neither L nor a force depends on the time.
    forced : tuple of str
        Coordinates on which a force acts beside those of L.
    damping : Value or None
        gamma where forces are f = -2 gamma L_v, in all coordinates.
    periodic : tuple of str
        Coordinates that enter L and the forces through sines and cosines of whole multiples only:
        angles.
    subsystems : tuple of Subsystem
        Groups of coordinates that nothing in L couples.
    zeros : mapping from str to (int, int)
        For M, its derivatives by q and the Hessian of V: entries that vanish, and all entries.
    undecided : tuple of str
        What could be neither proved nor refused; it counts as not there.
    nearly : tuple of str
        What fails by less than 1e-12, as 0.1 + 0.2 - 0.3 does: floats are taken as they are.
    plain : Plain
        The system in plain symbols, without what it was proved not to depend on.
    """

    n: int
    constant_mass: bool
    diagonal_mass: bool
    constant_rows: tuple[str, ...]
    gyroscopic: bool
    separable: bool
    linear: bool
    cyclic: tuple[str, ...]
    autonomous: bool
    forced: tuple[str, ...]
    damping: Value | None
    periodic: tuple[str, ...]
    subsystems: tuple[Subsystem, ...]
    zeros: dict[str, tuple[int, int]]
    undecided: tuple[str, ...]
    nearly: tuple[str, ...]
    plain: Plain = field(compare=False)
    system: Declared = field(compare=False)

    def __repr__(self) -> str:
        from symsimpson.declare.structure_table import as_text

        return as_text(self)

    def _repr_html_(self) -> str:
        from symsimpson.declare.structure_table import as_html

        return as_html(self)


def analyse(system: Declared) -> Structure:
    """Find out what a system has and lacks."""
    given, n = system.plain, system.n
    names = [user.func.__name__ for user in system.coordinates]
    plain, questions, findings = _freed(given, names)
    look = _Look(plain, findings)
    groups = connected(n, look.couplings())
    if len(groups) > len(connected(n, look.as_written())):
        split = _split(plain, groups)
        apart = _Look(split, None) if split is not None else look
        if split is None or len(connected(n, apart.as_written())) < len(groups):
            groups = connected(n, look.as_written())
        else:
            plain, look = split, apart
    subsystems = tuple(look.subsystem(group) for group in groups)
    moving = {i for place, value in plain.M.items() if look.moves(value) for i in place}
    triangle = {place: 1 + (place[0] != place[1]) for place in plain.M}
    return Structure(
        n=n,
        constant_mass=all(s.constant_mass for s in subsystems),
        diagonal_mass=all(i == j for i, j in plain.M),
        constant_rows=tuple(name for i, name in enumerate(names) if i not in moving),
        gyroscopic=any(c for c, _ in plain.a),
        separable=all(s.separable for s in subsystems),
        linear=all(s.linear for s in subsystems),
        cyclic=tuple(names[i] for s in subsystems for i in s.cyclic),
        autonomous=plain.autonomous,
        damping=damping_rate(plain),
        forced=tuple(name for name, (c, _) in zip(names, plain.f, strict=True) if c),
        periodic=tuple(names[i] for i, x in enumerate(look.q) if _angle(plain, x)),
        subsystems=subsystems,
        zeros={
            "M": (n * n - sum(triangle.values()), n * n),
            "dM/dq": (
                n**3 - sum(triangle[place] * look.moves(value) for place, value in plain.M.items()),
                n**3,
            ),
            "Hess V": (n * n - sum(map(look.moves, look.slope)), n * n),
        },
        undecided=questions[Dependence.UNDECIDED],
        nearly=questions[Dependence.NEARLY],
        plain=plain,
        system=system,
    )


class _Look:
    """Answers about the Lagrangian of a system."""

    def __init__(self, plain: Plain, before: Findings | None) -> None:
        graph, L = plain.graph, plain.L
        self._plain = plain
        self.q, self.v = plain.numbers(plain.q), plain.numbers(plain.v)
        written = (*plain.energies, *plain.f, *plain.held_values)
        self._present = frozenset().union(*(graph.nodes[n].symbols for _, n in written))
        both = gradient(graph, L, [*self.q, *self.v])
        L_q, self.P = both[: len(self.q)], both[len(self.q) :]
        self.F = [graph.add(pair) for pair in zip(L_q, plain.f, strict=True)]
        self.slope = gradient(graph, plain.V, self.q)
        values = [*self.F, *self.P, *self.slope, *written]
        self._findings = Findings(graph, values, before)

    def _met(self) -> Iterator[tuple[int, int, Value, int]]:
        """Return coordinates i, k of which k stands, as x, in a force or a momentum of i."""
        place = {x: i for group in (self.q, self.v) for i, x in enumerate(group)}
        for i, pair in enumerate(zip(self.F, self.P, strict=True)):
            for value in pair:
                for x in self._plain.graph.nodes[value[1]].symbols & place.keys():
                    yield i, place[x], value, x

    def couplings(self) -> set[tuple[int, int]]:
        """List the pairs of coordinates that L couples."""
        depends = self._findings.depends
        met = {(i, k) for i, k, value, x in self._met() if i != k and depends(value, x)}
        return met | self._held_together()

    def as_written(self) -> set[tuple[int, int]]:
        """List the pairs of coordinates of which one stands in the other's force or momentum."""
        return {(i, k) for i, k, _, _ in self._met()} | self._held_together()

    def _held_together(self) -> set[tuple[int, int]]:
        """List the pairs of coordinates that stand in one constraint, or that it binds."""
        nodes, place = self._plain.graph.nodes, {x: i for i, x in enumerate(self.q)}
        groups: list[Iterable[int]] = [
            [place[x] for x in nodes[n].symbols & place.keys()]
            for _, n in self._plain.constraints.values()
        ]
        groups += self._plain.bound
        return {(i, k) for group in groups for i in group for k in group if i != k}

    def moves(self, value: Value, among: Sequence[int] = ()) -> int:
        """Count the coordinates that a value depends on, or symbols among some."""
        present = self._plain.graph.nodes[value[1]].symbols & {*(among or self.q)}
        return sum(self._findings.depends(value, x) for x in present)

    def subsystem(self, group: Sequence[int]) -> Subsystem:
        """Say what the coordinates of a group have and lack."""
        plain, vanishes = self._plain, self._findings.vanishes
        inside = set(group)
        entries = [value for (i, _), value in plain.M.items() if i in inside]
        constant = not any(self.moves(value) or self._timed(value) for value in entries)
        rigid = not any(self.moves(plain.f[i], self.v) for i in group)
        nodes, own_q = plain.graph.nodes, {self.q[i] for i in group}
        held = any(nodes[n].symbols & own_q for _, n in plain.constraints.values())
        pulled = {i for row in plain.velocity_constraints.values() for i in group if row[i][0]}
        held = held or bool(pulled)
        separable = constant and rigid and all(vanishes(plain.a[i]) for i in group)
        forces = [self.slope[i] for i in group]
        x = [self.q[i] for i in group]
        free = not any(plain.f[i][0] for i in group) and not any(map(self._timed, forces))
        return Subsystem(
            coordinates=tuple(group),
            cyclic=tuple(
                i
                for i in group
                if vanishes(self.F[i]) and self.q[i] not in self._present and i not in pulled
            ),
            constant_mass=constant,
            separable=separable,
            linear=separable and free and not held and all(self._findings.affine(forces, x)),
            affine=constant
            and not (free or held)
            and len(group) <= MOST_AFFINE
            and self._affine(group),
        )

    def _affine(self, group: Sequence[int]) -> bool:
        """Return whether forces and momenta are affine in q and v, and their slopes constant."""
        states = [x for i in group for x in (self.q[i], self.v[i])]
        values = [values[i] for i in group for values in (self.F, self.P)]
        if not all(self._findings.affine(values, states)):
            return False
        plain, derivatives = self._plain, Derivatives(self._plain.graph)
        slopes = [derivatives(value, x) for value in values for x in states]
        given = (*plain.numbers(plain.u), plain.time)
        findings = Findings(plain.graph, slopes)
        return not any(findings.depends(slope, x) for slope in slopes for x in given)

    def _timed(self, value: Value) -> bool:
        """Return whether the time stands in a value."""
        return self._plain.time in self._plain.graph.nodes[value[1]].symbols


def _freed(
    given: Plain, names: Sequence[str]
) -> tuple[Plain, dict[Dependence, tuple[str, ...]], Findings]:
    """Write the energies without the coordinates that they do not depend on.

    Gives what is open, too, and the findings about the energies as they were.
    """
    graph, q = given.graph, given.numbers(given.q)
    findings = Findings(graph, [given.T, *given.energies])
    questions: dict[Dependence, list[str]] = {kind: [] for kind in Dependence}
    slope, samples = Derivatives(graph), Samples(given)

    def freed(what: str, value: Value) -> Value:
        if findings.vanishes(value):
            return ZERO
        present = graph.nodes[value[1]].symbols
        sure, idle = certain(given, findings, value), []
        for name, x in zip(names, q, strict=True):
            if x not in present:
                continue
            answer = Dependence.NONE
            if findings.depends(value, x):
                answer = Dependence.REAL if sure else samples.dependence(value, x, slope(value, x))
            if answer is Dependence.NONE:
                idle.append(x)
            questions[answer].append(f"whether {what} depends on {name}")
        without = fixed(graph, value, idle)
        if without is not None:
            return without
        for x in idle:
            value = fixed(graph, value, [x]) or value
        return value

    M = {(i, j): freed(f"M[{i},{j}]", value) for (i, j), value in given.M.items()}
    plain = replace(
        given,
        T=findings.freed(given.T, q),
        M={place: value for place, value in M.items() if value[0]},
        a=tuple(freed(f"a_{name}", a) for name, a in zip(names, given.a, strict=True)),
        V=freed("V", given.V),
    )
    answers = {kind: tuple(sorted(set(texts))) for kind, texts in questions.items()}
    return plain, answers, findings


def _split(plain: Plain, groups: Sequence[Sequence[int]]) -> Plain | None:
    """Write L as a sum over groups that nothing couples; None if that fails at all points."""
    graph, q = plain.graph, plain.numbers(plain.q)
    for number in NUMBERS:
        parts: list[Value] = []
        try:
            (constant,) = rebuilt(graph, [plain.V], dict.fromkeys(q, (number, 0)))
            for k, group in enumerate(groups):
                members = [q[i] for i in group]
                others = {x: (number, 0) for x in q if x not in members}
                parts += rebuilt(graph, [plain.V], others)
                if k:
                    parts.append(scaled(-1, constant))
        except ZeroDivisionError:
            continue
        V = graph.add(parts)
        if same(graph, plain.V, V):
            T = quadratic_form(graph, plain.M, plain.numbers(plain.v))
            return replace(plain, T=T, V=V)
    return None


def _angle(plain: Plain, x: int) -> bool:
    """Return whether x stands somewhere, and in sines and cosines alone, by whole multiples."""
    graph = plain.graph
    written = (*plain.energies, *plain.f, *plain.held_values)
    work = [n for c, n in written if c and x in graph.nodes[n].symbols]
    seen = set(work)
    while work:
        n = work.pop()
        kind, parts, _ = graph.nodes[n]
        if n == x:
            return False
        if kind == "function" and parts[0] in ("sin", "cos"):
            if not _whole(graph, parts[1], x):
                return False
            continue
        for m in graph.arguments(n):
            if m not in seen and x in graph.nodes[m].symbols:
                seen.add(m)
                work.append(m)
    return bool(seen)


def _whole(graph: Graph, angle: Value, x: int) -> bool:
    """Return whether an angle holds a whole multiple of x, and x nowhere else."""
    shares = {angle[1]: Fraction(angle[0])}
    for n in reversed(graph.reached([angle[1]])):  # each node once, behind all that hold it
        kind, parts, symbols = graph.nodes[n]
        share = shares.get(n)
        if not share or x not in symbols:
            continue
        if n == x:
            return share.denominator == 1
        if kind != "sum":
            return False
        for d, m in parts:
            shares[m] = shares.get(m, Fraction(0)) + share * d
    return True
