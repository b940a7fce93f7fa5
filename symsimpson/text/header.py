"""The header of a generated module: what it states of itself, read without executing it."""

from __future__ import annotations

import ast
import hashlib
import re
from collections.abc import Container, Mapping
from contextlib import suppress
from dataclasses import MISSING, dataclass, fields
from functools import cached_property
from types import MappingProxyType
from typing import Any

import numpy as np

from symsimpson.errors import StaleKernelError
from symsimpson.support.array_types import Ints
from symsimpson.text.interface import INTERFACE, PIVOTED
from symsimpson.text.syntax import definitions, outline, redefined
from symsimpson.text.workspace_layout import ADJACENT, BLOCKS, DRIVER_LAYOUT

#: Interfaces of modules in files of runs that can still be driven, each with the blocks that these
#: modules do not have. The driver has rows of its own for them, behind those of the module.
OLDER = {12: ("PIVOT_LIMIT", "PIVOT_TIME"), 13: ()}
#: Blocks by the names that they have in these modules.
RENAMED = {"RATE": "SLIP"}

#: Constants without which nothing is a module.
_SIZES = {"DIMENSION", "DEGREE", "UNKNOWNS", "NEWTON_UNKNOWNS", "NODES", "ROWS"}
#: The line above a module that holds the digest of what follows.
SIGNED = re.compile(r"^# sha256 of what follows: ([0-9a-f]{64})\n", re.MULTILINE)


@dataclass(frozen=True)
class Header:
    """Facts that a generated module states of itself, read without executing it."""

    #: Names, and the SHA-256 of the declaration.
    system: str
    scheme: str
    digest: str
    order: int
    coordinates: tuple[str, ...]
    parameters: tuple[str, ...]
    defaults: tuple[float, ...]  #: Values of the parameters.
    signs: tuple[str, ...]  #: "positive" or "negative" where a parameter was declared so, else "".
    real_everywhere: bool  #: Whether the energy has a value at each state.
    layout: Mapping[str, int]  #: Constants of the module: first rows of blocks, sizes, strides.
    tables: Mapping[str, tuple[Any, ...]]  #: Its lists of numbers.
    functions: tuple[str, ...]
    invariants: tuple[str, ...] = ()
    forces: tuple[str, ...] = ()
    inputs: tuple[str, ...] = ()
    input_places: tuple[str, ...] = ()  #: Nodes at which inputs are given, with fifty digits.
    constraints: tuple[str, ...] = ()
    carried: bool = False
    #: Whether nothing depends on t, momenta are damped, steps are those of another time.
    autonomous: bool = True
    conformal: bool = False
    retimed: bool = False
    #: Whether M has eigenvalues of both signs, and whether L is not quadratic in the velocities.
    indefinite: bool = False
    general: bool = False
    canonical: bool = False  #: Whether the system is declared by its Hamiltonian.
    #: What steps are differentiated by, besides the state.
    varied_by: tuple[str, ...] | None = None

    @property
    def degree(self) -> int:
        """Degree of the path of a step."""
        return self.layout["DEGREE"]

    @property
    def rows(self) -> int:
        """Number of rows of the workspace."""
        return self.layout["ROWS"]

    @property
    def newton_unknowns(self) -> int:
        """Number of unknowns of a step; 0 where it needs no iteration."""
        return self.layout["NEWTON_UNKNOWNS"]

    @property
    def coordinate_order(self) -> tuple[int, ...]:
        """The coordinate at each place; explicit steps have no loops, and so no order."""
        return self.tables.get("COORDINATE", tuple(range(self.n)))

    @cached_property
    def n(self) -> int:
        """Number of coordinates."""
        return len(self.coordinates)

    @property
    def velocity_constraints(self) -> tuple[str, ...]:
        """Names of the constraints, the last ones, that are constraints of velocities."""
        return self.constraints[self.layout.get("HOLONOMIC", len(self.constraints)) :]

    @cached_property
    def from_start(self) -> frozenset[str]:
        """Names of parameters that follow from the start of a run: E0 and the rate there."""
        return frozenset(self.parameters[-2:] if self.retimed else ())

    @property
    def nodes(self) -> int:
        """Number of nodes of a step."""
        return self.layout["NODES"]

    @property
    def conservative(self) -> bool:
        """Whether the energy is constant."""
        return self.autonomous and not self.forces and not self.carried

    @property
    def powers(self) -> int:
        """Number of values that change the energy: powers of forces and constraints, then dL/dt."""
        return len(self.forces) + self.carried + (not self.autonomous)

    @cached_property
    def by_stages(self) -> bool:
        """Whether steps are iterated by velocities and forces at the nodes, which are lanes."""
        return "iterate" in self.functions

    @property
    def fast_sines(self) -> bool:
        """Whether kernels use the fast sine and cosine, which have no value for huge angles."""
        return "sincos" in self.functions

    @property
    def unrolled(self) -> bool:
        """Whether Newton's method is written out, without loops and pivots."""
        return PIVOTED in self.functions

    @cached_property
    def driver_layout(self) -> Ints:
        """The numbers of the layout that the driver must know, in its order."""
        more = {
            "STATE_END": self.layout["INCREMENT"] + self.layout["UNKNOWNS"],
            "DIMENSION": self.n,
            "MEASURED": self.degree * self.n,
            "ROWS": self.rows,
            "STEPS_A_CALL": 1 << 62 if self.autonomous and not self.inputs else 1,
        }
        none = {
            "INPUT": 0,
            "INPUT_STRIDE": 0,
            "TANGENT": self.rows,
            "TIME": self.rows,
            "GROWN": self.rows,
            "PIVOT_SCALE": self.layout["PIVOT_LIMIT"],
            "RENEWED": 0,
            "RENEWAL": 1,
            "OF_EVENTS": 0,
            "OF_STATES": 0,
        }
        return np.array(
            [{**none, **self.layout, **more}[name] for name in DRIVER_LAYOUT], dtype=np.int64
        )


def read_header(text: str, where: str) -> Header:
    """Read the constants of a generated module from its syntax tree.

    Raises StaleKernelError if the text is not a module that this version's generator wrote,
    unchanged.
    """
    _check_digest(text, where)
    constants: dict[str, Any] = {}
    functions: list[str] = []
    try:
        body = outline(text).body
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        raise StaleKernelError(
            f"{where}: this is no Python, so no module that symsimpson generated.\n"
            "It is damaged, or was made by somebody else. Generate it anew."
        ) from None
    for node in body:
        match node:
            case ast.Assign(targets=[ast.Name(id=name)], value=value):
                if isinstance(value, ast.Call) and value.args:  # array((...))
                    value = value.args[0]
                with suppress(ValueError, TypeError, RecursionError, MemoryError):
                    constants[name] = ast.literal_eval(value)
            case ast.FunctionDef(name=name):
                functions.append(name)
    facts, layout = constants.get("FACTS"), _of_type(constants, int)
    check_interface(layout, where, (INTERFACE, *OLDER))
    if not (isinstance(facts, dict) and _are_facts(facts) and _fit(facts, layout)):
        raise StaleKernelError(
            f"{where}: what the module says of itself is not complete, or of other types.\n"
            "It is damaged, or was made by somebody else. Generate it anew."
        )
    _check_layout(layout, where)
    added = OLDER.get(layout["INTERFACE"], ())
    rows = {name: layout["ROWS"] + k for k, name in enumerate((*added, "ROWS"))}
    if layout["INTERFACE"] in OLDER:
        rows |= {new: layout[old] for old, new in RENAMED.items() if old in layout}
    layout = MappingProxyType({**layout, **rows})
    tables = _of_type(constants, tuple)
    return Header(**facts, layout=layout, tables=tables, functions=tuple(functions))


def check_interface(layout: Mapping[str, int], where: str, driven: Container[int]) -> None:
    """Raise StaleKernelError if the interface of a module is none of these."""
    if layout.get("INTERFACE") not in driven:
        raise StaleKernelError(
            f"{where}: the module has kernel interface {layout.get('INTERFACE')}, "
            f"this symsimpson drives interface {INTERFACE}.\n"
            "Generate it again: symsimpson generate, or symsimpson.generate(system, scheme)."
        )


def signed_anew(text: str) -> str:
    """Return the text of a module with the digest of what it says now."""
    banner = SIGNED.search(text)
    assert banner is not None
    return text.replace(banner[1], digest(text[banner.end() :]), 1)


def with_facts(text: str, facts: Mapping[str, object]) -> str:
    """Return the text of a module that says these facts of itself; the digest is not renewed."""
    first, end = definitions(text)["FACTS"]
    said = "".join(text.splitlines(keepends=True)[first:end]).partition("=")[2]
    return redefined(text, {"FACTS": f"FACTS = {ast.literal_eval(said.strip()) | facts!r}"})


def _are_facts(facts: Mapping[Any, Any]) -> bool:
    """Return whether these are facts of a module: all that it needs, of types that it should have.

    There is a value and a sign for each parameter.
    """
    known = {x.name: x for x in fields(Header) if x.name not in ("layout", "tables", "functions")}
    needed = {name for name, x in known.items() if x.default is MISSING}
    if not needed <= facts.keys() <= known.keys():
        return False
    if not all(_is_of(value, str(known[name].type)) for name, value in facts.items()):
        return False
    signs = set(facts["signs"]) <= {"", "positive", "negative"}
    sizes = len(facts["parameters"]) == len(facts["defaults"]) == len(facts["signs"])
    names = *facts["coordinates"], *facts["parameters"], *facts.get("inputs", ())
    return signs and sizes and len(set(names)) == len(names) and facts["order"] > 0


def _fit(facts: Mapping[str, Any], layout: Mapping[str, int]) -> bool:
    """Return whether the constants of a module have what its facts ask for."""
    asked = {"retimed": "TIME", "constraints": "HELD_SIZE", "inputs": "INPUT"}
    needed = _SIZES | {block for fact, block in asked.items() if facts.get(fact)}
    if not needed <= layout.keys() or layout["DIMENSION"] != len(facts["coordinates"]):
        return False
    places = facts.get("input_places", ())
    number = re.compile(r"[0-9]*\.?[0-9]+(e-?[0-9]+)?")
    return len(places) == layout["NODES"] * bool(facts.get("inputs")) and all(
        number.fullmatch(place) for place in places
    )


def _is_of(value: object, kind: str) -> bool:
    """Return whether a value has the type that an annotation names."""
    single = {"str": str, "int": int, "bool": bool, "float": float}
    kind, optional = kind.removesuffix(" | None"), kind.endswith(" | None")
    if kind in single:
        return type(value) is single[kind]
    inner = single[kind.removeprefix("tuple[").partition(",")[0]]
    return (value is None and optional) or (
        isinstance(value, tuple) and all(type(item) is inner for item in value)
    )


def _of_type(constants: Mapping[str, Any], kind: type) -> Mapping[str, Any]:
    return MappingProxyType({k: v for k, v in constants.items() if type(v) is kind})


def _check_layout(layout: Mapping[str, int], where: str) -> None:
    """Check that blocks that the driver moves as one stand behind one another."""
    order = sorted((block for block in BLOCKS if block in layout), key=layout.__getitem__)
    for blocks in ADJACENT:
        if BLOCKS[blocks[0]].optional and blocks[0] not in order:
            continue
        first = order.index(blocks[0]) if blocks[0] in order else 0
        if tuple(order[first : first + len(blocks)]) != blocks:
            raise StaleKernelError(
                f"{where}: the blocks {', '.join(blocks)} of the workspace do not follow one "
                "another.\nGenerate the module anew."
            )


def digest(text: str) -> str:
    """Return the SHA-256 of a text, in hexadecimal digits."""
    return hashlib.sha256(text.encode()).hexdigest()


def _check_digest(text: str, where: str) -> None:
    banner = SIGNED.search(text)
    if banner is None:
        raise StaleKernelError(
            f"{where}: this is no module that symsimpson generated: its banner has no digest.\n"
            "Only generated modules are loaded, because loading executes them. Generate one with "
            "symsimpson.generate(system, scheme)."
        )
    if digest(text[banner.end() :]) != banner[1]:
        raise StaleKernelError(
            f"{where}: the module does not match the digest in its banner: it was edited or "
            "damaged.\nIts equations can no longer be trusted. Change the system, not the file, "
            "and generate it anew."
        )
