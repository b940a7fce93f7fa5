"""A module with its compiled kernels, its names, and the values of its parameters."""

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
from symsimpson.support.names import NameTable, spelled
from symsimpson.text.header import Header, read_header
from symsimpson.text.syntax import check_structure


class Names:
    """Tables of the names of coordinates, parameters, inputs, constraints, forces and invariants.

    The names in a module are identifiers. The user's own names come from the declared system, or
    from a file next to the module. Without either, a module has only its own names.
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
            given |= {"constraints": plain.constraint_names, "forces": plain.forces}
            given |= {"invariants": plain.invariants, "units": getattr(declared, "units", {})}
        if defaults is not None:
            given["parameters"] = defaults

        def named(attribute: str, identifiers: tuple[str, ...]) -> NameTable:
            users = [spelled(key) for key in given.get(attribute, ())]
            fits = len(users) == len(identifiers)
            return NameTable(attribute.removesuffix("s"), identifiers, users if fits else None)

        self.coordinates = named("coordinates", header.coordinates)
        self.parameters = named("parameters", header.parameters)
        self.inputs = named("inputs", header.inputs)
        self.constraints = named("constraints", header.constraints)
        self.forces = named("forces", header.forces)
        self.invariants = named("invariants", header.invariants)
        self.units = {str(name): str(unit) for name, unit in dict(given.get("units", {})).items()}

    @property
    def users(self) -> dict[str, Any]:
        """Units, and the user's names that differ from the module's, for files."""
        tables = {name: x for name, x in vars(self).items() if isinstance(x, NameTable)}
        names = {name: [*x.shown] for name, x in tables.items() if x.shown != x.own}
        return names | ({"units": self.units} if self.units else {})

    @cached_property
    def idle(self) -> frozenset[int]:
        """Places of parameters that no expression contains; empty for an unknown system."""
        if self._declared is None:
            return frozenset()
        plain = self._declared.plain
        rows = (*plain.forces.values(), plain.constraint_values)
        values = [plain.L, *plain.invariants.values(), *chain(*rows)]
        elements = (*self._declared.contacts.values(), *self._declared.friction.values())
        drawn: set[Any] = set().union(*(x.free_symbols for x in elements))
        used = {n for _, node in values for n in plain.graph.nodes[node].symbols}
        for point in (self._declared.positions or {}).values():
            corners = point if isinstance(point[0], tuple) else (point,)
            drawn.update(*(x.free_symbols for x in chain(*corners)))
        parameters = zip(self._declared.parameters, plain.numbers(plain.parameters), strict=True)
        return frozenset(
            i for i, (symbol, n) in enumerate(parameters) if n not in used and symbol not in drawn
        )

    def warn_of_idle(self, system: str, changed: Iterable[int], beside: Any = None) -> None:
        """Warn if parameters that no expression contains have changed values.

        ``beside`` has the other expressions of a run, such as events and reductions. They may
        contain the parameters.
        """
        idle = [self.parameters.shown[i] for i in sorted(self.idle.intersection(changed))]
        pattern = re.compile(
            "|".join(rf"(?<!\w){re.escape(name)}(?!\w)" for name in idle) or "(?!)"
        )
        idle = [name for name in idle if name not in pattern.findall(str(beside))]
        if idle:
            verb = "stand" if len(idle) > 1 else "stands"
            warn(
                f"{system}: {', '.join(idle)} {verb} in no expression of the system, so other "
                "values have no effect.\nUsually a term is missing in T, V, H or the forces.",
                ModelWarning,
            )

    def varied(self, names: Iterable[str]) -> tuple[str, ...]:
        """Return the user's names of parameters and inputs, from the names in the module."""
        parameters, inputs = self.parameters, self.inputs
        known = dict(zip(parameters.own + inputs.own, parameters.shown + inputs.shown, strict=True))
        return tuple(known.get(name, name) for name in names)


@dataclass(frozen=True)
class Tools:
    """Functions of higher layers that a program calls. The layer that creates it passes them."""

    certify: Callable[..., Any]  #: Measures the properties of a stepper.
    #: Takes a program, its system, q0, parameters and h, and warns of steps that are too large.
    check_step: Callable[..., None]
    #: Takes a system, q, the values of parameters and inputs, and t. Returns the sum of the moduli
    #: of the terms of each force, which may cancel.
    force_terms: Callable[..., Any]
    #: Takes a system, times, positions and values of parameters. Returns the changes of V from the
    #: first state without round-off, or None.
    changes_of_potential: Callable[..., Any]
    #: Takes a system and a run. Returns the singular point of the coordinates at which it ended.
    at_pole: Callable[..., tuple[str, bool]]
    #: Takes a program, its system, a run, and a way to repeat its steps. Returns the time and the
    #: place of an unresolved passage with a small det M, and whether it is a singular point.
    unresolved_pole: Callable[..., Any]
    #: Takes a program, its system, the first and the present state of a run, h, values of
    #: parameters and the inputs of a step. Returns the same for the steps that follow.
    unresolved_step: Callable[..., Any]
    #: Takes a system, times, positions and values. Returns the time and the root of a force jump.
    kink_passed: Callable[..., Any]
    #: Takes a system, values, two corners of a box and a time. Returns the box if it contains no
    #: singular points and the system has no kinks, else None.
    regular_box: Callable[..., Any]
    #: Takes a system, times, positions and values. Returns the positions of its points by name.
    points_of: Callable[..., dict[str, Any]]
    #: Takes a quantity's name, a system with prescribed motions, states and inputs.
    prescribed: Callable[..., Any]
    #: Takes the name of a search for orbits, a stepper and arguments. Returns the orbit.
    find_orbits: Callable[..., Any]
    #: Takes the steps of a run, and returns second derivatives of its states.
    second_derivatives: Callable[..., Any]


@dataclass
class RunCache:
    """Results that the runs of a program share, so that later runs need not compute them."""

    #: Programs that also differentiate, by parameters and inputs, running cost, and whether twice.
    variants: dict[tuple[tuple[str, ...], Any, bool], Program] = field(default_factory=dict)
    #: Step sizes and parameter values for which the stability limit was checked.
    checked_steps: set[tuple[Any, bytes]] = field(default_factory=set)
    #: A box of positions without singular points of the coordinates, by parameter values.
    regular: dict[bytes, tuple[Any, Any]] = field(default_factory=dict)
    #: The number of failed searches for such a box, by parameter values.
    irregular: dict[bytes, int] = field(default_factory=dict)
    #: Workspaces for short runs. None if each state needs a check.
    prepared: list[Any] | None = None
    #: Step sizes and durations of transformed-time runs with too many steps for a short run.
    long: set[tuple[float, float]] = field(default_factory=set)
    #: Kernels by their number of lanes.
    wide: dict[int, KernelSets] = field(default_factory=dict)
    #: Multiprecision kernels, by the text of a module with expressions of events.
    many_digits: dict[str, KernelSets] = field(default_factory=dict)
    #: Programs of the modes of contacts and friction, by the key of the mode.
    modes: dict[Any, Program] = field(default_factory=dict)
    #: Events of runs, after their checks, and kernels of the outputs of functions.
    events: dict[Any, Any] = field(default_factory=dict)
    #: The faster number of lanes for members of an ensemble, by the number of lanes of a block.
    lanes: dict[int, int] = field(default_factory=dict)

    def regular_between(self, values: Reals, low: Reals, high: Reals) -> bool:
        """Return whether all positions from ``low`` to ``high`` are known to be regular."""
        box = self.regular.get(values.tobytes())
        return box is not None and bool((box[0] <= low).all() and (high <= box[1]).all())


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Program:
    """A module that is ready to run. Runs, ensembles, derivatives and results use it."""

    #: The text of the module, and its name in messages.
    source: str
    where: str
    header: Header
    numbers: Numbers  #: The arithmetic.
    kernels: KernelSets
    names: Names  #: The names of the user and of the module.
    defaults: Reals  #: Default values of the parameters, shape (m,).
    #: The default values by the names of the user.
    given_defaults: Mapping[str, float] | None = None
    #: Default values of the inputs, by name.
    default_inputs: Mapping[str, float] | None = None
    declared: Any = None  #: The system from which the module was generated.
    method: Any = None  #: The scheme from which the module was generated.
    derivation: Derivation | None = None  #: The record of the generation.
    tools: Tools | None = None
    reference_state: Mapping[str, Any] | None = None  #: An initial state: q0, and v0 or p0.
    #: Returns a program that also differentiates its steps by the named parameters and inputs.
    differentiate: Callable[..., Program] | None = None
    #: Returns the program of another system with the same scheme, such as a mode of contacts.
    compile_for: Callable[[Any], Program] | None = None
    findings: RunCache

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
        """The user's names of the coordinates."""
        return self.names.coordinates.shown

    @property
    def parameters(self) -> tuple[str, ...]:
        """The user's names of the parameters."""
        return self.names.parameters.shown

    @property
    def inputs(self) -> tuple[str, ...]:
        """The user's names of the inputs."""
        return self.names.inputs.shown

    @property
    def invariants(self) -> tuple[str, ...]:
        """The user's names of the invariants."""
        return self.names.invariants.shown

    @property
    def units(self) -> dict[str, str]:
        """The declared units of quantities, by name."""
        return dict(self.names.units)

    def __reduce__(self) -> tuple[Any, ...]:
        state, defaults = self.reference_state, self.given_defaults
        given = {
            "defaults": defaults and dict(defaults),
            "declared": self.declared,
            "method": self.method,
            "reference_state": state and dict(state),
            "numbers": self.numbers,
            "tools": self.tools,
            "differentiate": self.differentiate,
            "compile_for": self.compile_for,
            "names": self.names,
            "default_inputs": self.default_inputs,
        }
        return partial(new_program, self.source, self.where, **given), ()

    def __repr__(self) -> str:
        return f"Program({self.system}, {self.scheme})"

    @property
    def modes(self) -> Any:
        """The modes of a system with contacts or dry friction; None for other systems."""
        return getattr(self.declared, "modes", None)

    def kernels_for(self, lanes: int) -> KernelSets:
        """Return the kernels for a number of lanes."""
        wide = self.findings.wide
        if lanes not in wide:
            wide[lanes] = self.numbers.kernels(self.source, self.header, lanes)
        return wide[lanes]

    def values(self, given: Mapping[Any, Any] | None = None, beside: Any = None) -> Reals:
        """Return the values of all parameters, shape (m,): the defaults with the given values.

        The other expressions of a run, ``beside``, may contain parameters that the system does not
        contain. Raises InputError for an unknown name or for a value of the wrong sign.
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
        """Return the values of all parameters by name."""
        return dict(zip(self.parameters, self.values(given).tolist(), strict=True))

    def free_values(self, given: Mapping[Any, Any] | None = None) -> dict[str, Any]:
        """Return the values of the parameters that do not follow from the initial state."""
        values, from_start = self.named_values(given), self.header.from_start
        return {name: value for name, value in values.items() if name not in from_start}

    def check_given(self, given: Mapping[Any, Any] | None) -> None:
        """Raise InputError for values of parameters that follow from the initial state."""
        keys = self.header.from_start
        if keys and isinstance(given, Mapping) and not keys.isdisjoint(map(spelled, given)):
            reject(
                f"parameters contain values for {', '.join(sorted(keys))}, or for one of them.",
                why="These values follow from the initial state, and E0 is its energy.",
                remedy="Remove them from parameters.",
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
    """Return the program of a module's text. It compiles and executes nothing yet.

    Parameters
    ----------
    source, where, declared, **more
        The attributes of :class:`StraightLineCode`.
    defaults : mapping from str to float, optional
        The default values of the parameters in the module's order, by the user's names.
    numbers : Numbers, optional
        The arithmetic; double precision by default.
    names : Names, optional
        The names of another program for the same module.

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
        findings=RunCache(prepared=[] if free and numbers.compiled else None),
        **more,
    )


def read_program(
    text: str, where: str, tools: Tools | None = None, users: Mapping[str, Any] | None = None
) -> Program:
    """Return the program of a module from a file, after checks of its digest and structure.

    ``users`` has the names of the user from the file. Raises StaleKernelError if the text is not a
    module that this version generated.
    """
    header = read_header(text, where)  # compares the digest, executes nothing
    check_structure(text, where)
    names = Names(header, None, None, users) if users else None
    return new_program(text, where, tools=tools, names=names)


def report_of(program: Program) -> Report:
    """Return the times of derivation and compilation, and the size of the module."""
    derived, lines = program.derivation, len(program.source.splitlines())
    seconds = {"compilation": float(getattr(program.kernels, "seconds", 0.0))}
    if derived is None:
        return Report(seconds, lines, None, "")
    form = "unrolled" if derived.unrolled else "loops"
    return Report({**derived.seconds, **seconds}, lines, derived.operations, form)
