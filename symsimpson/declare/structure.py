"""The structure of a system, proved by algebra or by identity tests in a finite field.

The tests ask which symbols change the forces F = L_q + f and the momenta P = L_v. A wrong answer
has a probability below 2^-100 (:mod:`symsimpson.graph.field`). If the field leaves a question open,
evaluation in 60 digits may disprove the property, or SymPy may prove it. Other questions are
undecided, and the property counts as absent.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction

from symsimpson.declare.declared import Declared
from symsimpson.declare.identities import Dependence, SlopeSamples, is_certain
from symsimpson.declare.plain import Plain
from symsimpson.declare.quadratic import connected_groups, quadratic_form
from symsimpson.graph.derive import Derivatives, gradient
from symsimpson.graph.findings import IdentityTest
from symsimpson.graph.nodes import ZERO, Graph, Value, scale
from symsimpson.graph.rebuild import NUMBERS, agree_at_points, fix_symbols, rebuild

#: Largest number of unknowns of linear equations that are solved directly, without iteration.
MOST_AFFINE = 16


def damping_rate(plain: Plain) -> Value | None:
    """Return gamma if the forces are f = -2 gamma L_v, and None otherwise.

    gamma contains parameters only. The Lagrangian of the motion is e^(2 gamma t) L (R. McLachlan
    and M. Perlmutter, J. Geom. Phys. 39 (2001) 276).
    """
    graph, v = plain.graph, plain.numbers(plain.v)
    mass = plain.entry(0, 0)
    if not all(c for c, _ in plain.f) or not mass[0] or not plain.quadratic:
        return None
    slope = Derivatives(graph)(plain.f[0], v[0])
    if not slope[0]:
        return None
    rate = scale(
        -1, graph.multiply([slope, (1, graph.absorb_coefficient((2 * mass[0], mass[1])), -1)])
    )
    momenta = gradient(graph, plain.L, v)
    pairs = zip(plain.f, momenta, strict=True)
    left = [graph.add([f, graph.multiply([(2, 0), rate, p])]) for f, p in pairs]
    findings = IdentityTest(graph, [rate, *left])
    if not all(map(findings.vanishes, left)):
        return None
    moving = plain.numbers((*plain.q, *plain.v, *plain.u, plain.t))
    present = graph.nodes[rate[1]].symbols.intersection(moving)
    if any(findings.depends(rate, x) for x in present):
        return None
    return fix_symbols(graph, rate, present) if present else rate


def decay_rates(plain: Plain) -> tuple[Value, ...] | None:
    """Return Gamma_i if the forces are f_i = g_i(t, q, u) - Gamma_i (M v)_i, and None otherwise.

    M must be constant. Each Gamma_i contains parameters only, and is zero or known to be
    positive. If all are equal, they are twice the gamma of :func:`damping_rate`.
    """
    graph, v = plain.graph, plain.numbers(plain.v)
    n, derivatives = len(v), Derivatives(graph)
    slopes = [[derivatives(f, x) for x in v] for f in plain.f]
    rates = []
    for i in range(n):
        slope, inverse = slopes[i][i], (1, graph.absorb_coefficient(plain.entry(i, i)), -1)
        rates.append(scale(-1, graph.multiply([slope, inverse])) if slope[0] else ZERO)
    moving = set(plain.numbers((*plain.q, *plain.v, *plain.u, plain.t)))
    if any(not graph.nodes[k].symbols.isdisjoint(moving) for _, k in rates):
        return None
    left = [
        graph.add([slopes[i][j], graph.multiply([rates[i], plain.entry(i, j)])])
        for i in range(n)
        for j in range(n)
    ]
    findings = IdentityTest(graph, left)
    if not all(map(findings.vanishes, left)):
        return None
    known = all(not rate[0] or plain.signs(rate) == (1, True) for rate in rates)
    return tuple(rates) if known else None


@dataclass(frozen=True)
class Subsystem:
    """A group of coordinates whose motion does not depend on the other coordinates.

    Attributes
    ----------
    coordinates : tuple of int
        Indices of the coordinates in the system.
    cyclic : tuple of int
        Indices of coordinates that neither L nor a force depends on, and on which no force acts.
    constant_mass : bool
        Whether the block of M depends neither on q nor on t.
    separable : bool
        Whether L = T(v) - V(t, q): M is constant, L has no terms linear in v, and no force
        depends on v.
    linear : bool
        Whether V is quadratic and gives the only force: the system is separable, without t, and
        its force is linear in q.
    affine : bool
        Whether forces and momenta are affine in q and v, with coefficients of parameters only, M
        is constant, and forces act or t appears. Default False.
    """

    coordinates: tuple[int, ...]
    cyclic: tuple[int, ...]
    constant_mass: bool
    separable: bool
    linear: bool
    affine: bool = False


@dataclass(frozen=True, repr=False)
class Structure:
    """The properties of a system that the generator exploits, for all values of q and parameters.

    Attributes
    ----------
    n : int
        Number of coordinates.
    constant_mass, diagonal_mass : bool
        Whether M depends neither on q nor on t, and whether M is diagonal.
    constant_rows : tuple of str
        Coordinates whose row of M does not depend on q.
    gyroscopic : bool
        Whether L has terms linear in the velocities.
    separable, linear : bool
        Whether L = T(v) - V(q), and whether V is also quadratic.
    cyclic : tuple of str
        Coordinates that neither L nor a force depends on, and on which no force acts. Their
        momenta are constant.
    autonomous : bool
        Whether neither L nor a force depends on the time.
    forced : tuple of str
        Coordinates on which a declared force acts.
    damping : Value or None
        The node of gamma if the forces are f = -2 gamma L_v in all coordinates.
    periodic : tuple of str
        Angles: coordinates that L and the forces contain only in sines and cosines of whole
        multiples.
    subsystems : tuple of Subsystem
        Groups of coordinates that no term of L couples.
    zeros : mapping from str to (int, int)
        For M, dM/dq and the Hessian of V, the number of entries that vanish and of all entries.
    undecided : tuple of str
        Questions that could not be decided. The property counts as absent.
    nearly : tuple of str
        Properties that fail by less than 1e-12, for example because of 0.1 + 0.2 - 0.3. Floats
        count with their exact value.
    plain : Plain
        The system in plain symbols, without symbols that it was proved not to depend on.
    system : MechanicalSystem
        The declared system.
    momentum_rank : int or None
        The rank of the matrix H_pp at almost all states. It is None for a system without a
        declared Hamiltonian.

    Examples
    --------
    >>> import symsimpson as ss
    >>> structure = ss.systems.spherical_pendulum().structure
    >>> structure.cyclic, structure.periodic, structure.separable
    (('phi',), ('theta',), False)
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
    momentum_rank: int | None = None

    def __repr__(self) -> str:
        from symsimpson.declare.structure_table import as_text

        return as_text(self)

    def _repr_html_(self) -> str:
        from symsimpson.declare.structure_table import as_html

        return as_html(self)


def analyse(system: Declared) -> Structure:
    """Find the structure of a system."""
    given, n = system.plain, system.n
    names = [user.func.__name__ for user in system.coordinates]
    plain, questions, findings = _remove_idle_symbols(given, names)
    tests = _LagrangianTests(plain, findings)
    groups = connected_groups(n, tests.couplings())
    if len(groups) > len(connected_groups(n, tests.written_couplings())):
        split = _separate(plain, groups)
        split_tests = _LagrangianTests(split, None) if split is not None else tests
        if split is None or len(connected_groups(n, split_tests.written_couplings())) < len(groups):
            groups = connected_groups(n, tests.written_couplings())
        else:
            plain, tests = split, split_tests
    subsystems = tuple(tests.subsystem(group) for group in groups)
    states = (*tests.q, *tests.v)
    moving = {
        i for place, value in plain.M.items() if tests.count_moving(value, states) for i in place
    }
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
        periodic=tuple(names[i] for i, x in enumerate(tests.q) if _is_angle(plain, x)),
        subsystems=subsystems,
        zeros={
            "M": (n * n - sum(triangle.values()), n * n),
            "dM/dq": (
                n**3 - sum(triangle[i] * tests.count_moving(value) for i, value in plain.M.items()),
                n**3,
            ),
            "Hess V": (n * n - sum(map(tests.count_moving, tests.slope)), n * n),
        },
        undecided=questions[Dependence.UNDECIDED],
        nearly=questions[Dependence.NEARLY],
        plain=plain,
        system=system,
    )


class _LagrangianTests:
    """Tests of L, its forces F and its momenta P."""

    def __init__(self, plain: Plain, before: IdentityTest | None) -> None:
        graph, L = plain.graph, plain.L
        self._plain = plain
        self.q, self.v = plain.numbers(plain.q), plain.numbers(plain.v)
        written = (*plain.energies, *plain.f, *plain.constraint_values)
        self._present = frozenset().union(*(graph.nodes[n].symbols for _, n in written))
        both = gradient(graph, L, [*self.q, *self.v])
        L_q, self.P = both[: len(self.q)], both[len(self.q) :]
        self.F = [graph.add(pair) for pair in zip(L_q, plain.f, strict=True)]
        self.slope = gradient(graph, plain.V, self.q)
        values = [*self.F, *self.P, *self.slope, *written]
        self._findings = IdentityTest(graph, values, before)

    def _occurrences(self) -> Iterator[tuple[int, int, Value, int]]:
        """Yield i, k, a force or momentum of coordinate i, and the node of q_k or v_k in it."""
        place = {x: i for group in (self.q, self.v) for i, x in enumerate(group)}
        for i, pair in enumerate(zip(self.F, self.P, strict=True)):
            for value in pair:
                for x in self._plain.graph.nodes[value[1]].symbols & place.keys():
                    yield i, place[x], value, x

    def couplings(self) -> set[tuple[int, int]]:
        """Return the pairs of coordinates that L or a constraint couples."""
        depends = self._findings.depends
        pairs = self._occurrences()
        coupled = {(i, k) for i, k, value, x in pairs if i != k and depends(value, x)}
        return coupled | self._constraint_couplings()

    def written_couplings(self) -> set[tuple[int, int]]:
        """Return the pairs (i, k) for which a force or momentum of i contains q_k or v_k."""
        return {(i, k) for i, k, _, _ in self._occurrences()} | self._constraint_couplings()

    def _constraint_couplings(self) -> set[tuple[int, int]]:
        """Return the pairs of coordinates that one constraint contains or restricts."""
        nodes, place = self._plain.graph.nodes, {x: i for i, x in enumerate(self.q)}
        groups: list[Iterable[int]] = [
            [place[x] for x in nodes[n].symbols & place.keys()]
            for _, n in self._plain.constraints.values()
        ]
        groups += self._plain.constrained_coordinates
        return {(i, k) for group in groups for i in group for k in group if i != k}

    def count_moving(self, value: Value, among: Sequence[int] = ()) -> int:
        """Count the coordinates, or the symbols ``among`` some, that a value depends on."""
        present = self._plain.graph.nodes[value[1]].symbols & {*(among or self.q)}
        return sum(self._findings.depends(value, x) for x in present)

    def subsystem(self, group: Sequence[int]) -> Subsystem:
        """Find the properties of a group of coordinates."""
        plain, vanishes = self._plain, self._findings.vanishes
        inside = set(group)
        entries = [value for (i, _), value in plain.M.items() if i in inside]
        moving = (*self.q, *self.v)
        constant = not any(self.count_moving(x, moving) or self._contains_time(x) for x in entries)
        undamped = not any(self.count_moving(plain.f[i], self.v) for i in group)
        nodes, own_q = plain.graph.nodes, {self.q[i] for i in group}
        pulled = {i for row in plain.velocity_constraints.values() for i in group if row[i][0]}
        constrained = bool(pulled) or any(
            nodes[n].symbols & own_q for _, n in plain.constraints.values()
        )
        separable = constant and undamped and all(vanishes(plain.a[i]) for i in group)
        forces = [self.slope[i] for i in group]
        x = [self.q[i] for i in group]
        free = not any(plain.f[i][0] for i in group) and not any(map(self._contains_time, forces))
        linear = separable and free and not constrained
        return Subsystem(
            coordinates=tuple(group),
            cyclic=tuple(
                i
                for i in group
                if vanishes(self.F[i]) and self.q[i] not in self._present and i not in pulled
            ),
            constant_mass=constant,
            separable=separable,
            linear=linear and all(self._findings.affine(forces, x)),
            affine=constant
            and not (free or constrained)
            and len(group) <= MOST_AFFINE
            and self._affine(group),
        )

    def _affine(self, group: Sequence[int]) -> bool:
        """Return whether forces and momenta are affine in q and v with constant coefficients."""
        states = [x for i in group for x in (self.q[i], self.v[i])]
        values = [values[i] for i in group for values in (self.F, self.P)]
        if not all(self._findings.affine(values, states)):
            return False
        plain, derivatives = self._plain, Derivatives(self._plain.graph)
        slopes = [derivatives(value, x) for value in values for x in states]
        given = (*plain.numbers(plain.u), plain.time)
        findings = IdentityTest(plain.graph, slopes)
        return not any(findings.depends(slope, x) for slope in slopes for x in given)

    def _contains_time(self, value: Value) -> bool:
        """Return whether a value contains the time."""
        return self._plain.time in self._plain.graph.nodes[value[1]].symbols


def _remove_idle_symbols(
    given: Plain, names: Sequence[str]
) -> tuple[Plain, dict[Dependence, tuple[str, ...]], IdentityTest]:
    """Remove coordinates from the energies that do not depend on them.

    Return the system, the questions by answer, and the findings about the original energies.
    """
    graph, q = given.graph, given.numbers(given.q)
    findings = IdentityTest(graph, [given.T, given.L, *given.energies])
    questions: dict[Dependence, list[str]] = {kind: [] for kind in Dependence}
    slope, samples = Derivatives(graph), SlopeSamples(given)

    def remove_idle(what: str, value: Value) -> Value:
        if findings.vanishes(value):
            return ZERO
        present = graph.nodes[value[1]].symbols
        sure, idle = is_certain(given, findings, value), []
        for name, x in zip(names, q, strict=True):
            if x not in present:
                continue
            answer = Dependence.NONE
            if findings.depends(value, x):
                answer = Dependence.REAL if sure else samples.dependence(value, x, slope(value, x))
            if answer is Dependence.NONE:
                idle.append(x)
            questions[answer].append(f"whether {what} depends on {name}")
        without = fix_symbols(graph, value, idle)
        if without is not None:
            return without
        for x in idle:
            value = fix_symbols(graph, value, [x]) or value
        return value

    M = {(i, j): remove_idle(f"M[{i},{j}]", value) for (i, j), value in given.M.items()}
    plain = replace(
        given,
        T=findings.drop_symbols(given.T, q),
        lagrangian=given.lagrangian and findings.drop_symbols(given.lagrangian, q),
        M={place: value for place, value in M.items() if value[0]},
        a=tuple(remove_idle(f"a_{name}", a) for name, a in zip(names, given.a, strict=True)),
        V=remove_idle("V", given.V),
    )
    answers = {kind: tuple(sorted(set(texts))) for kind, texts in questions.items()}
    return plain, answers, findings


def _separate(plain: Plain, groups: Sequence[Sequence[int]]) -> Plain | None:
    """Write V as a sum over uncoupled groups; None if V is undefined at all points tried."""
    graph, q = plain.graph, plain.numbers(plain.q)
    for number in NUMBERS if plain.quadratic else ():
        parts: list[Value] = []
        try:
            (constant,) = rebuild(graph, [plain.V], dict.fromkeys(q, (number, 0)))
            for k, group in enumerate(groups):
                members = [q[i] for i in group]
                others = {x: (number, 0) for x in q if x not in members}
                parts += rebuild(graph, [plain.V], others)
                if k:
                    parts.append(scale(-1, constant))
        except ZeroDivisionError:
            continue
        V = graph.add(parts)
        if agree_at_points(graph, plain.V, V):
            T = quadratic_form(graph, plain.M, plain.numbers(plain.v))
            return replace(plain, T=T, V=V)
    return None


def _is_angle(plain: Plain, x: int) -> bool:
    """Return whether x appears, but only in sines and cosines of whole multiples."""
    graph = plain.graph
    written = (*plain.energies, *plain.f, *plain.constraint_values)
    work = [n for c, n in written if c and x in graph.nodes[n].symbols]
    seen = set(work)
    while work:
        n = work.pop()
        kind, parts, _ = graph.nodes[n]
        if n == x:
            return False
        if kind == "function" and parts[0] in ("sin", "cos"):
            if not _is_whole_multiple(graph, parts[1], x):
                return False
            continue
        for m in graph.arguments(n):
            if m not in seen and x in graph.nodes[m].symbols:
                seen.add(m)
                work.append(m)
    return bool(seen)


def _is_whole_multiple(graph: Graph, angle: Value, x: int) -> bool:
    """Return whether an angle is a whole multiple of x plus terms without x."""
    shares = {angle[1]: Fraction(angle[0])}
    for n in reversed(
        graph.descendants([angle[1]])
    ):  # each node once, after all nodes that contain it
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
