"""Write a module and its driver as a C99 file and header, without allocation, input or output.

Each function of the module and of the driver becomes a C function, for one trajectory. The template
``step.c`` has the functions that call them for a step. The code needs only <math.h>.
"""

from __future__ import annotations

import ast
import itertools
import os
import re
import textwrap
import unicodedata
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from importlib import resources
from pathlib import Path
from string import Template
from typing import Any

import numpy as np

from symsimpson.errors import reject
from symsimpson.program.driver import KernelSets, driver_text
from symsimpson.program.program import Program
from symsimpson.program.status import Status
from symsimpson.stepping.run import FALLBACK_STRETCH, HOPELESS
from symsimpson.support.contact_values import reject_contacts
from symsimpson.support.files import read_path, write_text
from symsimpson.targets.c.kinds import INT, KERNEL, POINTER, REAL, SET, Functions, Kinds, Source
from symsimpson.targets.c.statements import (
    HELPERS,
    WIDTH,
    WORDS,
    Expressions,
    comment,
    number,
    write_function,
)
from symsimpson.targets.llvm.intrinsics import read_functions
from symsimpson.targets.llvm.trees import Text, read_text
from symsimpson.text.header import Header
from symsimpson.text.interface import EXPLICIT, constants
from symsimpson.text.syntax import syntax
from symsimpson.text.workspace_layout import BLOCKS, DRIVER_LAYOUT

#: Outcomes of runs that cannot be the outcome of a single step.
RUN_OUTCOMES = (
    Status.INTERRUPTED,
    Status.DIVERGED,
    Status.SINGULAR_JACOBIAN,
    Status.FILE_ERROR,
    Status.RATE_NOT_POSITIVE,
    Status.TOLERANCE_NOT_MET,
)
OUTCOMES = "Results of a call: 0, or why it failed. A failed step does not change q and p."
#: The largest size of workspace copies on the stack, in bytes; programs usually have 8 MB.
MOST_STACK = 2**22
#: Public names of the C code, without their prefix.
PUBLIC = ("state", "begin", "begin_moving", "step", "energy", "get")
#: C names of functions whose own names <math.h> or C may use.
RENAMED = {"finite": "all_finite"}


class _KernelNameSets(KernelSets):
    """Sets of kernels, which contain the names of the kernels."""

    location = "a file of C"

    def compile_set(self, label: str, names: list[str], *, any_angle: bool) -> list[Any]:
        return names

    def pack(self, mode: int, kernels: list[Any]) -> Any:
        return mode, tuple(x or "0" for x in kernels)

    def address(self, name: str, *, any_angle: bool = False) -> Any:
        return name

    @property
    def all(self) -> list[tuple[int, tuple[str, ...]]]:
        """The sets in the order in which a step tries them, without repetitions."""
        return list(dict.fromkeys(map(self.set, self.fallbacks)))


def write_c(program: Program, prefix: str) -> tuple[str, str]:
    """Return the texts of the C header and of the C source of a stepper.

    All public names begin with ``prefix``. Raises InputError if the stepper has a ``precision``,
    the system has a time transformation, or a step needs more stack than ``MOST_STACK``.
    """
    header = program.header
    reject_contacts(program.modes, program.system, "C code")
    if not program.numbers.compiled:
        reject(
            "a stepper with many digits cannot be exported.",
            where=header.system,
            why="C has double precision.",
            remedy="Export the stepper compiled without precision. Its equations are the same.",
        )
    if header.retimed:
        reject(
            "a system with a time transformation cannot be exported.",
            where=header.system,
            why="Steps in C have a fixed size in time.",
            remedy="Export the system before retimed().",
        )
    if header.newton_unknowns and _stack(header) > MOST_STACK:
        reject(
            f"a step would take {_stack(header) / 2**20:.0f} MB of stack in C.",
            where=header.system,
            why=f"The limit is {MOST_STACK / 2**20:.0f} MB.",
            remedy="Export a system with fewer coordinates. If M is constant, you can also export "
            "an explicit scheme such as 'kahan_li8'.",
        )
    return _Writer(program, prefix).files()


def _stack(header: Header) -> int:
    """Return the size of the workspace copies of a step on the stack, in bytes."""
    return 8 * (2 * header.rows + 9 * header.layout["UNKNOWNS"] + 64)


@dataclass(frozen=True, eq=False)
class _Writer:
    """Writes the header and the source file of a program."""

    program: Program
    prefix: str

    @property
    def _header(self) -> Header:
        return self.program.header

    @cached_property
    def _sets(self) -> list[tuple[int, tuple[str, ...]]]:
        return _KernelNameSets(self._header, by_stages=self._header.by_stages).all

    @cached_property
    def _driver(self) -> Text:
        return read_functions(driver_text())

    @cached_property
    def _expressions(self) -> Expressions:
        """The writer of expressions, which knows the kinds of all functions that a step calls."""
        text, driver = self.program.source, self._driver
        driver_layout = dict(zip(DRIVER_LAYOUT, self._header.driver_layout.tolist(), strict=True))
        module = read_text(text)
        sources = [
            Source(module.functions, module.constants, driver_layout, text.splitlines()),
            Source(driver.functions, driver.constants, driver_layout, driver_text().splitlines()),
        ]
        functions = Functions(sources)
        kinds = Kinds(functions)
        taken = {*WORDS, *(f"{self.prefix}_{x}" for x in PUBLIC)}
        names = {k: RENAMED.get(k, f"{k}_" if k in taken else k) for k in functions}
        for kernel in self._kernels:
            kinds.follow(kernel, [REAL, REAL, POINTER])
        modes = {mode for mode, _ in self._sets}
        kinds.follow("finite", [POINTER, INT, INT])
        kinds.follow("begin", [SET, KERNEL, REAL, REAL, POINTER])
        kinds.follow("change_to", [SET, INT, REAL, REAL, POINTER])
        if EXPLICIT in modes:
            for name in ("keep", "put_back"):
                kinds.follow(name, [POINTER, INT, INT, POINTER])
        else:
            kinds.follow("take_one", [SET, REAL, REAL, POINTER])
        return Expressions(kinds, names)

    @cached_property
    def _kernels(self) -> list[str]:
        """Names of the kernels that sets contain, or that ``step.c`` calls."""
        called = [x for _, kernels in self._sets for x in kernels if x != "0"]
        return list(dict.fromkeys([*called, "legendre", "energy"]))

    def files(self) -> tuple[str, str]:
        """Return the texts of the header and of the source."""
        write = self._expressions
        functions = [
            line
            for name in _dependency_order(write.kinds)
            for line in write_function(write.kinds.functions[name], write)
        ]
        step = self._fill_template("step.c").splitlines()
        agreed = {**self._driver.constants, **constants(), **self._header.layout}
        for name in re.findall(r"\b[A-Z][A-Z_]+\b", "\n".join(step)):  # constants that it names
            if name in agreed:
                write.constants.setdefault(name, agreed[name])
        lines = [
            *comment(self._source_comment()),
            "",
            "#include <math.h>",
            f'#include "{self.prefix}.h"',
            "",
            *self._constants(),
            "typedef void kernel(double h, double t, double *W);",
            "typedef struct {",
            "    int mode;",
            "    kernel *call[7];",
            "} kernels;",
            "",
            *(HELPERS[name] for name in sorted(write.helpers)),
            *functions,
            *self._tables_of_kernels(),
            *step,
        ]
        return self._fill_template("step.h"), "\n".join(lines) + "\n"

    def _source_comment(self) -> str:
        """Return the first comment of the source file."""
        header = self._header
        doc = syntax(self.program.source).body[0].value.value  # type: ignore[attr-defined]
        about = re.sub("(?m)^(State|Parameters):", r"    \1:", doc.split("Kernels take")[0].strip())
        return (
            f"{about}\n\nWritten by symsimpson from the module of digest {header.digest[:16]}; "
            "change the system, not this file. W is the workspace, which consists of blocks of "
            "rows. It has one lane, for one trajectory. Do not compile with -ffast-math: it would "
            "break the compensated sums."
        )

    def _header_comment(self) -> str:
        """Return the first comment of the header file."""
        header = self._header
        pairs = zip(header.parameters, header.defaults, strict=True)
        parameters = ", ".join(f"{name} ({value:g})" for name, value in pairs) or "none"
        return (
            f"{header.system}: {header.scheme}, of order {header.order}. Written by symsimpson; "
            "change the system, not this file.\n\n"
            f"    Coordinates: {', '.join(header.coordinates)}\n"
            f"    Parameters, with the values of the declaration: {parameters}\n"
            f"    Inputs, held constant during a step: {', '.join(header.inputs) or 'none'}\n\n"
            "The arrays q, v, p, parameters and inputs have this order. p are the conjugate "
            "momenta dL/dv. Units are those of the declaration. Angles are not wrapped. The code "
            f"allocates no memory and has no global state. A state has {8 * header.rows + 24} "
            f"bytes, and each thread can have its own.{self._constraint_comment()}"
        )

    def _constraint_comment(self) -> str:
        """Return the paragraph of the comment about constraints; "" without constraints."""
        names = self._header.constraints
        if not names:
            return ""
        return (
            f"\n\nThe initial positions must satisfy the constraints {', '.join(names)}. The "
            "initial velocities or momenta must satisfy their time derivatives. The C code does "
            "not check this. In Python, system.consistent(q0, v0) returns such a state."
        )

    def _constants(self) -> Iterator[str]:
        """Yield the constants: blocks of the workspace in their order, then all others."""
        values = self._expressions.constants
        whole = {k: v for k, v in values.items() if isinstance(v, (int, np.integer))}
        blocks = {k: whole.pop(k) for k in sorted(whole, key=whole.__getitem__) if k in BLOCKS}
        yield "/* The first row of each block of the workspace. */"
        yield "enum {"
        for name, value in blocks.items():
            line = f"    {name} = {value},"
            yield f"{line:<36}/* {BLOCKS[name].doc} */"
        yield f"    ROWS = {whole.pop('ROWS') + 1}"  # the last row is the driver's
        yield "};"
        yield ""
        yield "/* Sizes, strides, limits and results of steps. */"
        yield "enum {"
        pairs = ", ".join(f"{name}~=~{number(x)}" for name, x in whole.items())
        lines = textwrap.wrap(pairs, WIDTH, initial_indent="    ", subsequent_indent="    ")
        yield from (line.replace("~", " ") for line in lines)
        yield "};"
        yield ""
        for name, value in values.items():
            if name in whole or name in blocks or name == "ROWS":
                continue
            table = np.asarray(value)
            kind = "int" if table.dtype.kind == "i" else "double"
            places = "".join(f"[{size}]" for size in table.shape)
            line = f"static const {kind} {name}{places} = {_entries(table)};"
            yield from textwrap.wrap(line, WIDTH, subsequent_indent="    ")
        yield ""

    def _places(self) -> Iterator[str]:
        for kind in ("coordinates", "parameters", "inputs"):
            first = f"    {self.prefix}_{kind[:-1]}".upper()
            for place, name in enumerate(identifiers(getattr(self.program.names, kind).shown)):
                yield f"{first}_{name} = {place}"

    def _tables_of_kernels(self) -> Iterator[str]:
        yield "/* Sets of kernels. A step tries the next set if a set fails. */"
        yield "static const kernels SETS[] = {"
        for mode, names in self._sets:
            yield f"    {{{mode}, {{0, {', '.join(names)}}}}},"
        yield "};"
        yield f"enum {{ NUMBER_OF_SETS = {len(self._sets)}, STRETCH = {FALLBACK_STRETCH} }};"
        yield ""

    def _fill_template(self, name: str) -> str:
        """Fill in the template ``name`` of this folder, for explicit or implicit steps."""
        header = self._header
        modes = {mode for mode, _ in self._sets}
        explicit, n = EXPLICIT in modes, header.n
        outcomes = [x for x in Status if x not in RUN_OUTCOMES]
        text = resources.files("symsimpson.targets.c").joinpath(name).read_text("utf-8")
        parts = {
            "explicit": explicit,
            "solved": not explicit,
            "inputs": bool(header.inputs),
            "free": not header.inputs,
        }
        for part, kept in parts.items():
            replacement = r"\g<1>" if kept else ""
            text = re.sub(
                rf"^ *//if {part}\n(.*?)^ *//end {part}\n", replacement, text, flags=re.M | re.S
            )
        width = max(len(x.name) for x in outcomes)
        sentences = [f"  {x.name}: {x.message}" for x in outcomes[1:]]  # lines that stay lines
        return Template(text).substitute(
            prefix=self.prefix,
            PREFIX=self.prefix.upper(),
            n=n,
            parameters=len(header.parameters),
            inputs=len(header.inputs),
            rows=header.rows + 1,
            stack=_stack(header),
            hopeless="".join(
                f"\n            || W[STATUS] == {x.name}" for x in HOPELESS if x not in RUN_OUTCOMES
            ),
            defaults=", ".join(map(number, header.defaults)) or "0.0",
            said="\n".join(comment(self._header_comment())),
            places=",\n".join(self._places()),
            outcomes=",\n".join(
                f"    {self.prefix.upper()}_{x.name:<{width}} = {x.value}" for x in outcomes
            ),
            meanings="\n".join(comment("\n".join([OUTCOMES, *sentences]))),
        )


def identifiers(names: Sequence[str]) -> list[str]:
    """Return a different C identifier for each name."""
    parts = {name: name for name in names if re.fullmatch(r"\w+", name, re.ASCII)}
    for name in names:
        letters = unicodedata.normalize("NFKD", name)
        word = "".join(_in_ascii(x) for x in letters if not unicodedata.combining(x))
        word = re.sub(r"\W+", "_", word, flags=re.ASCII)
        different = itertools.chain([word], (f"{word}_{k}" for k in itertools.count(2)))
        parts.setdefault(name, next(x for x in different if x not in parts.values()))
    return [parts[name] for name in names]


def _in_ascii(letter: str) -> str:
    """Return an ASCII letter, or the last word of its Unicode name, such as "omega"."""
    word = letter if letter.isascii() else unicodedata.name(letter, "unknown").split()[-1]
    return word.lower() if letter.islower() else word


def _dependency_order(kinds: Kinds) -> Iterator[str]:
    """Iterate over function names, each after the functions that it calls."""
    visited: set[str] = set()

    def visit(name: str) -> Iterator[str]:
        if name in visited:
            return
        visited.add(name)
        for statement in kinds.functions[name].body:
            for x in ast.walk(statement):
                if isinstance(x, ast.Name) and x.id in kinds.signatures:
                    yield from visit(x.id)
        yield name

    for name in list(kinds.signatures):
        yield from visit(name)


def _entries(table: Any) -> str:
    if table.ndim:
        return f"{{{', '.join(map(_entries, table))}}}"
    return number(table.item())


#: C identifiers that do not begin with an underscore.
NAME = re.compile("[A-Za-z][A-Za-z0-9_]*", re.ASCII)


def write_files(program: Program, path: str | os.PathLike[str]) -> tuple[Path, Path]:
    """Write the header and the source file of a stepper; raises InputError or StorageError."""
    place = read_path("path", path)
    name = place.name.removesuffix(".c").removesuffix(".h")
    if not NAME.fullmatch(name) or name in {*WORDS, "math"}:
        reject(
            f"path is {os.fspath(path)!r}, but {name!r} cannot be a prefix of C names.",
            remedy="Use letters, digits and underscores, with a letter first: 'firmware/top'.",
        )
    texts = write_c(program, name)
    paths = place.with_name(f"{name}.h"), place.with_name(f"{name}.c")
    for target, text in zip(paths, texts, strict=True):
        write_text(target, text, "C file")
    return paths
