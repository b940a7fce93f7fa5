"""Read a generated module: what it states of itself, and its compiled kernels."""

from __future__ import annotations

import ast
import hashlib
import re
import time
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType, ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from symsimpson.errors import StaleKernelError
from symsimpson.runtime.kernels.cache import compiled, whereabouts

__all__ = ["INTERFACE", "SIGNED", "Facts", "Kernels", "digest", "equations_of", "read_facts"]

#: The kernel interface that this runtime drives.
INTERFACE = 7

#: The line above a module that holds the digest of what follows.
SIGNED = re.compile(r"^# sha256 of what follows: ([0-9a-f]{64})\n", re.MULTILINE)

_NEWTON = ("prepare", "start", "newton", "advance")
_EXPLICIT = ("prepare", "start", "advance")
_STAGES = ("prepare", "start_stages", "iterate", "advance_stages")
#: Runs begin with it: compiled beside the kernels of a step, because they share functions.
_BEGIN = "legendre"


@dataclass(frozen=True)
class Facts:
    """What a generated module states of itself, read without executing it."""

    system: str
    scheme: str
    digest: str
    order: int
    degree: int
    newton_unknowns: int
    coordinates: tuple[str, ...]
    parameters: tuple[str, ...]
    defaults: tuple[float, ...]
    signs: tuple[str, ...]
    invariants: tuple[str, ...]
    real_everywhere: bool
    rows: int
    row_order: tuple[int, ...]
    column_order: tuple[int, ...]
    coordinate_order: tuple[int, ...]
    layout: Mapping[str, int]
    functions: tuple[str, ...]

    @cached_property
    def n(self) -> int:
        """Number of coordinates."""
        return len(self.coordinates)

    @cached_property
    def by_stages(self) -> bool:
        """Whether steps are iterated by velocities and forces at the nodes, which are lanes."""
        return "iterate" in self.functions

    @property
    def fast_sines(self) -> bool:
        """Whether kernels use the fast sine and cosine, which have no value for huge angles."""
        return "sincos" in self.functions

    @property
    def straight(self) -> bool:
        """Whether Newton's method is written out, without loops and pivots."""
        return "newton_pivoted" in self.functions

    @cached_property
    def places(self) -> NDArray[np.int64]:
        """What the driver must know of the layout, in its order."""
        names = (
            "ACTIVE", "MISMATCH_SQUARED", "STATUS", "CONTRACTION", "SCALE", "ITERATIONS",
            "POSITION", "MOMENTUM", "INCREMENT",
        )  # fmt: skip
        rows = [self.layout[name] for name in names]
        end = self.layout["INCREMENT"] + self.degree * self.n
        saved = [
            self.layout[name]
            for name in (
                "PREVIOUS", "SOLVED", "COUNT", "RELATIVE", "IN_DOUBT", "ENERGY", "INCREMENT_SQUARED"
            )
        ]  # fmt: skip
        return np.array([*rows, end, self.layout["METRIC"], self.n, *saved], dtype=np.int64)


def equations_of(facts: Facts, run: Any) -> tuple[NDArray[Any], NDArray[Any]]:
    """Read residual (d, n) and Jacobian (d, n, d, n) that the equations left in a workspace.

    Rows are those of the module; columns are brought into the order X_1..X_d.
    """
    at, n, d = facts.layout, facts.n, facts.degree
    place = np.argsort(facts.coordinate_order)
    unknown = (
        np.arange(d)[:, None] * at["EQUATION_ROW_STEP"] + place * at["EQUATION_PLACE_STEP"]
    ).ravel()
    residual = run.rows("RESIDUAL", d * n)[unknown].reshape(d, n)
    near = np.abs(place[:, None] - place) <= at["BAND"]
    inside = np.tile(near, (d, d))
    entries = unknown[:, None] * at["EQUATION_STRIDE"] + at["EQUATION_OFFSET"] + unknown
    matrix = run.rows("JACOBIAN", at["ROWS"] - at["JACOBIAN"])
    jacobian = np.where(inside, matrix[np.where(inside, entries, 0)], 0.0).reshape(d, n, d, n)
    return residual, jacobian[:, :, [facts.column_order.index(k) for k in range(1, d + 1)]]


def read_facts(text: str, where: str) -> Facts:
    """Read the constants of a generated module from its syntax tree.

    Raises
    ------
    StaleKernelError
        If the text is not a module that this version's generator wrote, unchanged.
    """
    _check_digest(text, where)
    constants: dict[str, Any] = {}
    functions: list[str] = []
    try:
        body = ast.parse(text).body
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        raise StaleKernelError(
            f"{where}: this is no Python, so no module that symsimpson generated.\n"
            "It is damaged, or was made by somebody else. Generate it anew."
        ) from None
    for node in body:
        if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name):
            value = node.value
            if isinstance(value, ast.Call) and value.args:  # array((...))
                value = value.args[0]
            try:
                constants[node.targets[0].id] = ast.literal_eval(value)
            except ValueError:
                continue
        elif isinstance(node, ast.FunctionDef):
            functions.append(node.name)
    if constants.get("INTERFACE") != INTERFACE:
        raise StaleKernelError(
            f"{where}: the module has kernel interface {constants.get('INTERFACE')}, "
            f"this symsimpson drives interface {INTERFACE}.\n"
            "Generate it anew: symsimpson generate, or symsimpson.generate(system, scheme)."
        )
    names = {
        "system": "SYSTEM", "scheme": "SCHEME", "digest": "DIGEST", "order": "ORDER",
        "degree": "DEGREE", "newton_unknowns": "NEWTON_UNKNOWNS",
        "coordinates": "COORDINATES", "parameters": "PARAMETERS",
        "defaults": "DEFAULTS", "signs": "SIGNS", "invariants": "INVARIANTS",
        "real_everywhere": "REAL_EVERYWHERE", "rows": "ROWS",
        "row_order": "ROW_ORDER", "column_order": "COLUMN_ORDER",
        "coordinate_order": "COORDINATE",
    }  # fmt: skip
    blocks = {
        name: value
        for name, value in constants.items()
        if type(value) is int and re.fullmatch(r"[A-Z][A-Z_]+", name)
    }
    return Facts(
        **{field: constants[name] for field, name in names.items()},
        layout=MappingProxyType(blocks),
        functions=tuple(functions),
    )


def digest(text: str) -> str:
    """Give the SHA-256 of a text, in hexadecimal digits."""
    return hashlib.sha256(text.encode()).hexdigest()


def _check_digest(text: str, where: str) -> None:
    found = SIGNED.search(text)
    if found is None:
        raise StaleKernelError(
            f"{where}: this is no module that symsimpson generated: its banner has no digest.\n"
            "Only generated modules are loaded, because loading executes them. Generate one with "
            "symsimpson.generate(system, scheme)."
        )
    if digest(text[found.end() :]) != found[1]:
        raise StaleKernelError(
            f"{where}: the module does not match the digest in its banner: it was edited or "
            "damaged.\nIts equations can no longer be trusted. Change the system, not the file, "
            "and generate it anew."
        )


class Kernels:
    """The kernels of one module, compiled or loaded from the cache when first asked for."""

    def __init__(self, text: str, facts: Facts, lanes: int = 1) -> None:
        # run-time values are no part of what is compiled, nor is the banner above the module
        body = text[text.index('"""') :]
        body = re.sub(r"^DEFAULTS = \([^)]*\)\n", "", body, count=1, flags=re.MULTILINE)
        self._text = body.replace("LANES = 1\n", f"LANES = {lanes}\n", 1)
        self._facts = facts
        self._staged = facts.by_stages and lanes == 1  # nodes are lanes, or members are
        self._single: dict[tuple[str, bool], int] = {}
        self.seconds = 0.0  # spent on compiling, or on loading what is compiled

    @cached_property
    def ladder(self) -> tuple[str, ...]:
        """Names of the kernels to take steps with, each where the one before fails."""
        first = ("stages",) if self._staged else ()
        return (*first, "newton", *(("robust",) if self._facts.newton_unknowns else ()))

    @property
    def whereabouts(self) -> str:
        """Where the compiled code of a step is, in words."""
        return whereabouts(self._text, "stages" if self._staged else "step")

    @cached_property
    def newton(self) -> NDArray[np.int64]:
        """Addresses of prepare, start, newton and advance; 0 for newton where nothing is solved."""
        if not self._facts.newton_unknowns:
            return np.insert(self._begun("step", _EXPLICIT), 2, 0)
        return self._watched(self._begun("step", _NEWTON))

    def _watched(self, kernels: NDArray[np.int64], *, any_angle: bool = False) -> NDArray[np.int64]:
        """Add the energy where Newton's method takes what stages could not solve."""
        if not self._staged:
            return kernels
        return np.append(kernels, [1, self.address("energy", any_angle=any_angle)])

    @cached_property
    def stages(self) -> NDArray[np.int64]:
        """Addresses of the same for an iteration over stages; one more says that it is one."""
        return np.append(self._begun("stages", _STAGES), 1)

    def _begun(self, label: str, names: tuple[str, ...]) -> NDArray[np.int64]:
        """Give addresses of kernels of a step, and remember that of what is compiled with them."""
        *step, begin = self._addresses(self._text, label, (*names, _BEGIN))
        self._single.setdefault((_BEGIN, False), int(begin))
        return np.array(step)

    @cached_property
    def robust(self) -> NDArray[np.int64]:
        """Addresses of the same with row pivoting and the library's sine and cosine.

        They take any angle and meet no singular pivot, at several times the cost.
        """
        pivoted = "newton_pivoted" if self._facts.straight else "newton"
        names = ("prepare", "start", pivoted, "advance")
        return self._watched(self._addresses(self._any_angle, "robust", names), any_angle=True)

    @cached_property
    def _any_angle(self) -> str:
        """The text with the library's sine and cosine."""
        plain = "@compiled\ndef sincos(x):\n    return sin(x), cos(x)\n\n\n"
        pattern = r"@compiled\ndef sincos\(x\):\n.*?\n\n\n"
        text = re.sub(pattern, plain, self._text, flags=re.DOTALL)
        return text.replace(
            "from numba import", "from math import cos, sin\n\nfrom numba import", 1
        )

    def address(self, name: str, *, any_angle: bool = False) -> int:
        """Give the address of one kernel; of one that takes any angle, if that is asked for."""
        key = name, any_angle
        if key == (_BEGIN, False):
            _ = self.stages if self._staged else self.newton
        if key not in self._single:  # finding it among what is compiled takes the text's digest
            text = self._any_angle if any_angle else self._text
            label = f"{name}_any_angle" if any_angle else name
            self._single[key] = int(self._addresses(text, label, (name,))[0])
        return self._single[key]

    def observing(self, kernel: str, rows: int) -> int:
        """Give the address of a further kernel, whose text is compiled behind the module's.

        The workspace has so many more rows, from what was ROWS on.
        """
        before = self._facts.rows
        text = self._text.replace(f"ROWS = {before}\n", f"ROWS = {before + rows}\n", 1)
        return int(self._addresses(f"{text}\n\n{kernel}", "observe", ("observe",))[0])

    def _addresses(self, text: str, label: str, names: tuple[str, ...]) -> NDArray[np.int64]:
        def compile_kernels(module: ModuleType) -> tuple[list[Any], NDArray[np.int64]]:
            from numba import cfunc

            kernels = [
                cfunc(module.SIGNATURE, cache=True, **module.OPTIONS)(getattr(module, name))
                for name in names
            ]
            return kernels, np.array([kernel.address for kernel in kernels], dtype=np.int64)

        start = time.perf_counter()
        found = compiled(text, label, compile_kernels)[1]
        self.seconds += time.perf_counter() - start
        return found
