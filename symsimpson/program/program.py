"""A module, compiled, with its names and the values of its parameters."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property, partial
from itertools import chain
from typing import Any

import numpy as np

from symsimpson.errors import ModelWarning, reject
from symsimpson.program.driver import KernelSets
from symsimpson.program.input_values import read_parameters
from symsimpson.program.numbers import FLOAT64, Numbers
from symsimpson.support.array_types import Reals
from symsimpson.support.calling import warn
from symsimpson.support.derivation import Derivation, Report
from symsimpson.support.names import Named, spelled
from symsimpson.text.header import Header, read_header
from symsimpson.text.syntax import check_structure


class Names:
    """Names of all that a module has; a user's own names come before those of the module.

    A module writes names as identifiers alone. Those that a user gave are known where the system is
    that it was made of; a module from a file has none but its own.
    """

    def __init__(
        self,
        header: Header,
        declared: Any,
        defaults: Mapping[str, Any] | None,
        users: Mapping[str, Any] | None = None,
    ) -> None:
        self._declared, given = declared, dict(users or {})
        if declared is not None:
            plain = declared.plain
            given = {"coordinates": declared.coordinates, "inputs": declared.inputs}
            given |= {"constraints": plain.held, "forces": plain.forces}
            given |= {"invariants": plain.invariants, "units": getattr(declared, "units", {})}
        if defaults is not None:
            given["parameters"] = defaults

        def named(attribute: str, identifiers: tuple[str, ...]) -> Named:
            users = [spelled(key) for key in given.get(attribute, ())]
            fits = len(users) == len(identifiers)
            return Named(attribute.removesuffix("s"), identifiers, users if fits else None)

        self.coordinates = named("coordinates", header.coordinates)
        self.parameters = named("parameters", header.parameters)
        self.inputs = named("inputs", header.inputs)
        self.constraints = named("constraints", header.constraints)
        self.forces = named("forces", header.forces)
        self.invariants = named("invariants", header.invariants)
        self.units = {str(name): str(unit) for name, unit in dict(given.get("units", {})).items()}

    @property
    def users(self) -> dict[str, Any]:
        """Units, and the names that a user gave where they are not the module's; for files."""
        tables = {name: x for name, x in vars(self).items() if isinstance(x, Named)}
        names = {name: [*x.shown] for name, x in tables.items() if x.shown != x.own}
        return names | ({"units": self.units} if self.units else {})

    @cached_property
    def idle(self) -> frozenset[int]:
        """Places of parameters that stand in no expression, as far as the system is known."""
        if self._declared is None:
            return frozenset()
        plain = self._declared.plain
        rows = (plain.a, *plain.forces.values(), plain.held_values)
        values = [plain.T, plain.V, *plain.M.values(), *plain.invariants.values(), *chain(*rows)]
        used = {n for _, node in values for n in plain.graph.nodes[node].symbols}
        drawn: set[Any] = set()
        for point in (self._declared.positions or {}).values():
            corners = point if isinstance(point[0], tuple) else (point,)
            drawn.update(*(x.free_symbols for x in chain(*corners)))
        parameters = zip(self._declared.parameters, plain.numbers(plain.parameters), strict=True)
        return frozenset(
            i for i, (symbol, n) in enumerate(parameters) if n not in used and symbol not in drawn
        )

    def warn_of_idle(self, system: str, changed: Iterable[int], beside: Any = None) -> None:
        """Warn where values are given to parameters that stand in no expression.

        They may stand ``beside`` the system, in events of a run or in what is observed of it.
        """
        idle = [self.parameters.shown[i] for i in sorted(self.idle.intersection(changed))]
        pattern = re.compile(
            "|".join(rf"(?<!\w){re.escape(name)}(?!\w)" for name in idle) or "(?!)"
        )
        idle = [name for name in idle if name not in pattern.findall(str(beside))]
        if idle:
            verb = "stand" if len(idle) > 1 else "stands"
            warn(
                f"{system}: {', '.join(idle)} {verb} in no expression of the system, so that other "
                "values have no effect.\nA term that was forgotten in T, V or the forces is the "
                "usual cause.",
                ModelWarning,
            )

    def varied(self, names: Iterable[str]) -> tuple[str, ...]:
        """Return what a user calls parameters and inputs that have these names in the module."""
        parameters, inputs = self.parameters, self.inputs
        known = dict(zip(parameters.own + inputs.own, parameters.shown + inputs.shown, strict=True))
        return tuple(known.get(name, name) for name in names)


@dataclass(frozen=True)
class Tools:
    """Functions of layers above a program; it gets them from whoever makes it."""

    certify: Callable[..., Any]  #: Measures whether a stepper is what it should be.
    #: Takes a program, its system, q0, parameters and h, and warns of steps that are too large.
    check_step: Callable[..., None]
    #: Takes a system, q, the values of parameters and inputs, and t; returns how large the terms of
    #: each force are, which may cancel.
    force_terms: Callable[..., Any]
    #: Takes a system, times, positions and values of parameters; returns how far V is from where it
    #: was first, as if it were not rounded, or None.
    changes_of_potential: Callable[..., Any]
    #: Takes a system and a run; returns at which singular point of the coordinates that ended.
    at_pole: Callable[..., tuple[str, bool]]
    #: Takes a program, its system, a run, and how its steps are to be taken again; returns when and
    #: where that passed a small det M unresolved, and whether such a point is there.
    unresolved_pole: Callable[..., Any]
    #: Takes a program, its system, where a run began and where it is, h, values of parameters and
    #: the inputs of a step; returns the same of the steps that follow.
    unresolved_step: Callable[..., Any]
    #: Takes a system, times, positions and values; returns when a force jumped at which root.
    kink_passed: Callable[..., Any]
    #: Takes a system, values, two corners and a time; returns a box without either.
    regular_box: Callable[..., Any]
    #: Takes a system, times, positions and values; returns where its points are, by name.
    points_of: Callable[..., dict[str, Any]]


@dataclass
class Findings:
    """Knowledge of a program that its runs have gathered, so that later ones need not."""

    #: Programs that differentiate by these parameters and inputs, and a running cost.
    variants: dict[tuple[tuple[str, ...], Any, bool], Program] = field(default_factory=dict)
    #: Steps and values of parameters for which the limit of stability was looked at.
    checked_steps: set[tuple[Any, bytes]] = field(default_factory=set)
    #: By values of parameters: a box of positions without singular points of the coordinates.
    regular: dict[bytes, tuple[Any, Any]] = field(default_factory=dict)
    #: How often such a box was not found.
    irregular: dict[bytes, int] = field(default_factory=dict)
    #: Workspaces for short runs; None where states have to be looked at one by one.
    prepared: list[Any] | None = None
    #: Steps and lengths of runs that are not short, though it did not seem so.
    long: set[tuple[float, float]] = field(default_factory=set)
    #: By numbers of lanes: kernels for so many trajectories at a time.
    wide: dict[int, KernelSets] = field(default_factory=dict)
    #: By texts of modules with expressions of events: kernels in many digits.
    many_digits: dict[str, KernelSets] = field(default_factory=dict)
    events: dict[Any, Any] = field(default_factory=dict)  #: Events of runs, as they were read.
    #: By lanes that stand side by side: how many members of an ensemble are faster.
    lanes: dict[int, int] = field(default_factory=dict)

    def regular_between(self, values: Reals, low: Reals, high: Reals) -> bool:
        """Return whether positions are known to be in a box without singular points."""
        box = self.regular.get(values.tobytes())
        return box is not None and bool((box[0] <= low).all() and (high <= box[1]).all())


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Program:
    """A module that is ready to run: what runs, ensembles, derivatives and results take."""

    #: Text of the module, and its name in messages.
    source: str
    where: str
    header: Header
    numbers: Numbers  #: What is computed with.
    kernels: KernelSets
    names: Names  #: What users call things.
    defaults: Reals  #: Values of the parameters, unless others are given, shape (m,).
    #: The same as they were given, by names that users may pass.
    given_defaults: Mapping[str, float] | None = None
    #: Values of the inputs in runs that are given none.
    default_inputs: Mapping[str, float] | None = None
    declared: Any = None  #: The system that the module was generated from.
    derivation: Derivation | None = None  #: Record of its generation.
    tools: Tools | None = None
    reference_state: Mapping[str, Any] | None = None  #: A state to start from: q0, and v0 or p0.
    #: Returns a program that also differentiates its steps by the named parameters and inputs.
    differentiate: Callable[..., Program] | None = None
    findings: Findings

    @property
    def n(self) -> int:
        """Number of coordinates."""
        return self.header.n

    @property
    def system(self) -> str:
        """Name of the system."""
        return self.header.system

    @property
    def scheme(self) -> str:
        """Name of the scheme."""
        return self.header.scheme

    @property
    def order(self) -> int:
        """Order of the scheme."""
        return self.header.order

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Names of the coordinates, as users know them."""
        return self.names.coordinates.shown

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of the parameters, as users know them."""
        return self.names.parameters.shown

    @property
    def inputs(self) -> tuple[str, ...]:
        """Names of the inputs, as users know them."""
        return self.names.inputs.shown

    @property
    def invariants(self) -> tuple[str, ...]:
        """Names of the quantities to watch, as users know them."""
        return self.names.invariants.shown

    @property
    def units(self) -> dict[str, str]:
        """Units of quantities by name, as they were declared with the system."""
        return dict(self.names.units)

    def __reduce__(self) -> tuple[Any, ...]:
        state, defaults = self.reference_state, self.given_defaults
        given = {
            "defaults": defaults and dict(defaults),
            "declared": self.declared,
            "reference_state": state and dict(state),
            "numbers": self.numbers,
            "tools": self.tools,
            "differentiate": self.differentiate,
            "names": self.names,
            "default_inputs": self.default_inputs,
        }
        return partial(new_program, self.source, self.where, **given), ()

    def __repr__(self) -> str:
        return f"Program({self.system}, {self.scheme})"

    def kernels_for(self, lanes: int) -> KernelSets:
        """Return the kernels for so many trajectories at a time."""
        wide = self.findings.wide
        if lanes not in wide:
            wide[lanes] = self.numbers.kernels(self.source, self.header, lanes)
        return wide[lanes]

    def values(self, given: Mapping[Any, Any] | None = None, beside: Any = None) -> Reals:
        """Return values of all parameters, the defaults but for those that are given.

        They are of use to the system, or to what is asked for ``beside`` it. Raises InputError if
        one is unknown, or not as it was declared.
        """
        if given is None:
            return self.defaults.copy()
        self.check_given(given)
        values = read_parameters(
            self.names.parameters, self.header.signs, self.defaults, given, self.numbers
        )
        if self.names.idle:
            self.names.warn_of_idle(self.system, np.flatnonzero(values != self.defaults), beside)
        return values

    def named_values(self, given: Mapping[Any, Any] | None = None) -> dict[str, Any]:
        """Return values of all parameters by name."""
        return dict(zip(self.parameters, self.values(given).tolist(), strict=True))

    def free_values(self, given: Mapping[Any, Any] | None = None) -> dict[str, Any]:
        """Return the values of those parameters that do not follow from the start."""
        values, from_start = self.named_values(given), self.header.from_start
        return {name: value for name, value in values.items() if name not in from_start}

    def check_given(self, given: Mapping[Any, Any] | None) -> None:
        """Refuse values of parameters that follow from the start of a run; raises InputError."""
        keys = self.header.from_start
        if keys and isinstance(given, Mapping) and not keys.isdisjoint(map(spelled, given)):
            reject(
                f"parameters give {', '.join(sorted(keys))}, or one of them, which follow from the "
                "start of a run.",
                remedy="Leave them out: E0 is the energy there.",
            )


def new_program(
    source: str,
    where: str,
    *,
    defaults: Mapping[str, float] | None = None,
    numbers: Numbers | None = None,
    names: Names | None = None,
    declared: Any = None,
    **more: Any,
) -> Program:
    """Return the program of a module's text; nothing is compiled or executed yet.

    Parameters
    ----------
    source, where, declared, **more
        As attributes of :class:`Program`.
    defaults : mapping from str to float, optional
        Default parameter values in the module's order, by the names that users may pass.
    numbers : Numbers, optional
        Double precision unless given.
    names : Names, optional
        What users call things, if another program knows.

    Raises
    ------
    StaleKernelError
        If the text is no module of this version.
    """
    header = read_header(source, where)
    numbers = numbers or FLOAT64
    free = header.real_everywhere and not (header.constraints or header.inputs)
    return Program(
        source=source,
        where=where,
        header=header,
        numbers=numbers,
        kernels=numbers.kernels(source, header),
        names=names or Names(header, declared, defaults),
        defaults=numbers.read(header.defaults if defaults is None else list(defaults.values())),
        given_defaults=defaults,
        declared=declared,
        findings=Findings(prepared=[] if free and numbers.compiled else None),
        **more,
    )


def read_program(
    text: str, where: str, tools: Tools | None = None, users: Mapping[str, Any] | None = None
) -> Program:
    """Return the program of a module from a file, once digest and structure are checked.

    ``users`` are the names that stand beside it there: those that a user gave. Raises
    StaleKernelError if it is not a module that this version generated.
    """
    header = read_header(text, where)  # compares the digest, executes nothing
    check_structure(text, where)
    names = Names(header, None, None, users) if users else None
    return new_program(text, where, tools=tools, names=names)


def report_of(program: Program) -> Report:
    """Return how long deriving and compiling took, and how long the result is."""
    derived, lines = program.derivation, len(program.source.splitlines())
    seconds = {"compilation": float(getattr(program.kernels, "seconds", 0.0))}
    if derived is None:
        return Report(seconds, lines, None, "")
    form = "unrolled" if derived.unrolled else "loops"
    return Report({**derived.seconds, **seconds}, lines, derived.operations, form)
