"""A small target-neutral program: scalar definitions, rows of the workspace, indexed loops."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from symsimpson.codegen.emitted_names import NameTable
from symsimpson.codegen.expression import Expression
from symsimpson.module.workspace_layout import BLOCKS

__all__ = [
    "Assign",
    "Call",
    "Excerpt",
    "Function",
    "IfActive",
    "Index",
    "Kernel",
    "Load",
    "Loop",
    "Module",
    "Row",
    "Section",
    "Statement",
    "Store",
]


@dataclass(frozen=True)
class Row:
    """One row of the workspace: a named block and an index in it, a number or an expression."""

    block: str
    index: int | str

    def __post_init__(self) -> None:
        assert self.block in BLOCKS, self.block

    def __str__(self) -> str:
        return f"W[{self.block} + {self.index}, lane]" if self.index else f"W[{self.block}, lane]"


@dataclass(frozen=True)
class Load:
    """``target = W[row, lane]``."""

    target: Expression
    row: Row


@dataclass(frozen=True)
class Store:
    """``W[row, lane] = value``, or ``+=`` with ``add``; ``moving`` only where a lane is active."""

    row: Row
    value: Expression
    moving: bool = False
    add: bool = False


@dataclass(frozen=True)
class Index:
    """``target = table[...]``: an integer from a table of the module."""

    target: str
    source: str


@dataclass(frozen=True)
class Assign:
    """``target = value``."""

    target: Expression
    value: Expression


@dataclass(frozen=True)
class Call:
    """A call of a function, on one lane of the workspace or of values; ``results`` take values."""

    function: str
    arguments: tuple[str | Expression, ...] = ("W", "lane")
    results: tuple[Expression, ...] = ()


@dataclass(frozen=True)
class Section:
    """A commented group of statements."""

    title: str
    body: tuple[Statement, ...]


@dataclass(frozen=True)
class Loop:
    """``for index in over``."""

    index: str
    over: str
    body: tuple[Statement, ...]


@dataclass(frozen=True)
class IfActive:
    """Statements that are skipped in lanes that are not active."""

    body: tuple[Statement, ...]


@dataclass(frozen=True)
class Excerpt:
    """Excerpt of a text of the library, with no indentation of the first one."""

    lines: tuple[str, ...]


Statement = Load | Store | Index | Assign | Call | Section | Loop | IfActive | Excerpt


@dataclass(frozen=True)
class Function:
    """A part of kernels: a function on one lane of the workspace."""

    name: str
    doc: str
    body: tuple[Statement, ...]
    arguments: tuple[str, ...] = ("W", "lane")

    @property
    def call(self) -> Call:
        """The call of it where its arguments have the names that they have in it."""
        return Call(self.name, self.arguments)


@dataclass(frozen=True)
class Kernel:
    """One function ``(h, t, workspace)`` over all lanes of a block.

    It is ``straight`` if its loops are to be unrolled, however long.
    """

    name: str
    doc: str
    body: tuple[Statement, ...]
    straight: bool = False


@dataclass(frozen=True)
class Module:
    """Everything that an emitter needs to write a module.

    ``layout`` gives the first row of each block of the workspace, ``rows`` their number.
    ``newton_unknowns`` is the number of unknowns of a step, 0 where it needs no iteration, and
    ``tables`` are constants that its loops read. ``facts`` resolve conditions in the functions of
    the library.
    """

    names: NameTable
    functions: tuple[Function, ...]
    kernels: tuple[Kernel, ...]
    constants: Mapping[Expression, Expression]
    layout: Mapping[str, int]
    rows: int
    newton_unknowns: int
    tables: Mapping[str, object]
    facts: Mapping[str, object] = field(default_factory=dict)
