"""A small target-neutral program: scalar definitions, rows of the workspace, indexed loops."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from heapq import heappop, heappush
from itertools import groupby

from symsimpson.lower.emitted_names import NameTable
from symsimpson.lower.expression import Expression
from symsimpson.lower.levels import Definition
from symsimpson.text.workspace_layout import BLOCKS


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
    """``W[row, lane] = value``, or ``+=`` with ``add``; only in active lanes with ``moving``."""

    row: Row
    value: Expression
    moving: bool = False
    add: bool = False


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

    @property
    def values(self) -> list[Expression]:
        """The arguments that are expressions."""
        return [x for x in self.arguments if isinstance(x, Expression)]


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
    """Lines of a text, with no indentation of the first one."""

    lines: tuple[str, ...]


Statement = Load | Store | Assign | Call | Section | Loop | IfActive | Excerpt


@dataclass(frozen=True)
class Function:
    """A part of kernels: a function on one lane of the workspace."""

    name: str
    doc: str
    body: tuple[Statement, ...]
    arguments: tuple[str, ...] = ("W", "lane")


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
    """The kernels, functions and tables of a module.

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


def store_rows(block: str, values: Iterable[Expression]) -> list[Store]:
    """Store values in the first rows of a block."""
    return [Store(Row(block, k), value) for k, value in enumerate(values)]


def _by_section(definitions: Sequence[Definition]) -> list[Definition]:
    """Order definitions so that definitions of one section are adjacent as far as possible.

    Each definition follows its operands. Sections begin in the order of their first definitions.
    """
    maker = {target: n for n, d in enumerate(definitions) for target in d.targets}
    needs = [{maker[s] for s in d.symbols if s in maker} for d in definitions]
    users: dict[int, list[int]] = {}
    for n, made_of in enumerate(needs):
        for m in made_of:
            users.setdefault(m, []).append(n)
    first: dict[str, int] = {}
    for n, definition in enumerate(definitions):
        first.setdefault(definition.section, n)
    ready: dict[str, list[int]] = {section: [] for section in first}
    for n, made_of in enumerate(needs):
        if not made_of:
            heappush(ready[definitions[n].section], n)
    ordered: list[Definition] = []
    section = next(iter(first), "")
    while len(ordered) < len(definitions):
        if not ready[section]:
            section = min((s for s in ready if ready[s]), key=first.__getitem__)
        n = heappop(ready[section])
        ordered.append(definitions[n])
        for user in users.get(n, ()):
            needs[user].discard(n)
            if not needs[user]:
                heappush(ready[definitions[user].section], user)
    return ordered


def sections(definitions: Sequence[Definition], common: str | None) -> list[Section]:
    """Group consecutive definitions under their section's title, with its operation count."""
    ordered, section_list = definitions if common else _by_section(definitions), []
    for title, group in groupby(ordered, lambda definition: common or definition.section):
        members = [*group]
        operations = sum(definition.operations for definition in members)
        pairs = sum(definition.function == "sincos" for definition in members)
        count = f"{operations} operations" + (f", {pairs} sincos" if pairs else "")
        statements = tuple(
            Call(d.function, d.values, d.targets) if d.function else Assign(*d.targets, *d.values)
            for d in members
        )
        section_list.append(Section(f"{title}: {count}", statements))
    return section_list
