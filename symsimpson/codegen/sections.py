"""Definitions in sections, as they stand in a text."""

from __future__ import annotations

from collections.abc import Sequence
from heapq import heappop, heappush

from symsimpson.codegen.ir import Assign, Call, Section, Statement
from symsimpson.codegen.levels import Definition

__all__ = ["sections"]


def _by_section(definitions: Sequence[Definition]) -> list[Definition]:
    """Order definitions so that those of a section stand together as far as they can.

    Each stands behind what it is made of. Sections begin in the order of their first definitions.
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
    groups: list[tuple[str, list[Definition]]] = []
    for definition in definitions if common else _by_section(definitions):
        title = common or definition.section
        if not groups or groups[-1][0] != title:
            groups.append((title, []))
        groups[-1][1].append(definition)
    section_list = []
    for title, members in groups:
        body: list[Statement] = []
        pairs = 0
        operations = 0
        for definition in members:
            function, targets, values = definition.function, definition.targets, definition.values
            operations += definition.operations
            pairs += function == "sincos"
            body.append(Call(function, values, targets) if function else Assign(*targets, *values))
        count = f"{operations} operations" + (f", {pairs} sincos" if pairs else "")
        section_list.append(Section(f"{title}: {count}", tuple(body)))
    return section_list
