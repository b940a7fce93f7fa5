"""Specialisation of library texts: conditions on facts are resolved."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterable, Iterator, Mapping
from functools import lru_cache

from symsimpson.lower.ir import Excerpt, Kernel, Loop
from symsimpson.text.library import kernel_sources

_NAMES = """
    TRACED AUTONOMOUS DRIVEN TIMED DRAGGED DAMPED FRICTION GYROSCOPIC RETIMED ALIKE
    HELD HOLONOMIC ROLLING MOVING FIRST_SIDE CARRIED WEIGHTED CONSTANT_MASS PIVOTS
    CYCLIC EXTRA SEPARABLE FOLLOWS STRAIGHT_PATH COMPOSED ITERATED FOLLOWING
    CLEARED IN_PAIRS NEWTON_IN_ORDER LOOKED_AT
    DIFFERENTIATED VARIED_BY SIZED GRIDDED COSTED TIMED_COST SECOND BY_COLUMNS SYMMETRIC
"""
#: Names of facts: a condition must not use one that is not known.
FACTS = frozenset(_NAMES.split())


def specialise(text: str, facts: Mapping[str, object]) -> str:
    """Return a text of functions in which conditions on facts are resolved.

    Comments and line breaks stay. Raises KeyError for a name of :data:`FACTS` that is not known.
    """
    named = (FACTS | facts.keys()).intersection(re.findall(r"\w+", text))
    return _specialise(text, tuple((x, facts[x]) for x in sorted(named) if x in facts))


@lru_cache(maxsize=1024)
def _specialise(text: str, facts: tuple[tuple[str, object], ...]) -> str:
    known = dict(facts)
    while changed := _resolve_conditions(text, known):
        text = changed
    return text


def collect_called(
    names: Iterable[str], sources: Mapping[str, str], facts: Mapping[str, object]
) -> dict[str, str]:
    """Return texts of functions and of all that they call, with conditions on facts resolved."""
    texts: dict[str, str] = {}
    waiting = {name for name in names if name in sources}
    while waiting:
        name = waiting.pop()
        texts[name] = specialise(sources[name], facts)
        calls = re.findall(r"\b(\w+)\(", texts[name])
        waiting |= {x for x in calls if x in sources and x not in texts}
    return texts


def kernel_from_text(name: str, facts: Mapping[str, object]) -> Kernel:
    """Return the kernel of a library text, in a loop over lanes."""
    text = specialise(kernel_sources()[name], facts)
    (function,) = ast.parse(text).body
    assert isinstance(function, ast.FunctionDef)
    documentation, *body = function.body
    lines = text.splitlines()[documentation.end_lineno :] if body else ["    pass"]
    lane = Excerpt(tuple(line.removeprefix("    ") for line in lines))
    doc = ast.get_docstring(function, clean=False) or ""
    return Kernel(name, doc, (Loop("lane", "range(LANES)", (lane,)),))


def _resolve(test: ast.expr, facts: Mapping[str, object]) -> object:
    """Return the value of a condition, or its remaining expression."""
    if not isinstance(test, ast.BoolOp):
        parts = [*ast.walk(test)]
        names = {part.id for part in parts if isinstance(part, ast.Name)}
        if any(isinstance(part, (ast.Subscript, ast.Call)) for part in parts):
            return test
        if unknown := names & FACTS - facts.keys():
            raise KeyError(f"The module has no value of {', '.join(sorted(unknown))}.")
        known = names <= facts.keys()
        return eval(ast.unparse(test), {"__builtins__": {}}, {**facts}) if known else test
    every, left = isinstance(test.op, ast.And), []
    for value in (_resolve(operand, facts) for operand in test.values):
        if isinstance(value, ast.expr):
            left.append(value)
        elif bool(value) is not every:
            return not every
    if left == test.values:
        return test
    return ast.BoolOp(test.op, left) if len(left) > 1 else left[0] if left else every


def _resolve_conditions(text: str, facts: Mapping[str, object]) -> str:
    """Return the text with its outer conditions resolved, without superfluous ``pass``.

    The text is empty if nothing changes.
    """
    lines = text.splitlines()
    # lines of the text and their replacements; outer nodes come before inner ones
    changes: dict[range, list[str]] = {}
    for node in _nodes(ast.parse(text).body, lines):
        place: ast.stmt | ast.expr | None = None
        match node:
            case ast.If(test) if (value := _resolve(test, facts)) is not test:
                place, kept = node, [*_branches(node, value, lines)]
            case ast.IfExp(test) if not isinstance(value := _resolve(test, facts), ast.expr):
                taken = ast.get_source_segment(text, node.body if value else node.orelse)
                after = lines[(node.end_lineno or 0) - 1][node.end_col_offset :]
                place = node
                kept = [f"{lines[node.lineno - 1][: node.col_offset]}{taken}{after}"]
            case ast.For(body=[ast.Pass()]):
                place, kept = node, [f"{' ' * node.col_offset}pass"]
            case (
                ast.FunctionDef(body=[_, _, *_])
                | ast.For(body=[_, _, *_])
                | ast.If(body=[_, _, *_])
            ):
                place, kept = next((x for x in node.body if isinstance(x, ast.Pass)), None), []
        if place is not None:
            here = range(place.lineno - 1, place.end_lineno or 0)
            if all(here.stop <= x.start or x.stop <= here.start for x in changes):
                changes[here] = kept
    for here in sorted(changes, key=lambda x: x.start, reverse=True):
        lines[here.start : here.stop] = changes[here]
    return "\n".join(lines) if changes else ""


def _nodes(statements: Iterable[ast.stmt], lines: list[str]) -> Iterator[ast.AST]:
    """Yield statements and the conditional expressions in them, outer ones first."""
    for statement in statements:
        yield statement
        inner = [*getattr(statement, "body", ()), *getattr(statement, "orelse", ())]
        end = inner[0].lineno - 1 if inner else statement.end_lineno
        if any(" else " in line for line in lines[statement.lineno - 1 : end]):
            yield from (x for x in ast.walk(statement) if isinstance(x, ast.IfExp))
        yield from _nodes(inner, lines)


def _branches(node: ast.If, value: object, lines: list[str]) -> Iterator[str]:
    """Yield the lines of an ``if`` after its condition got this value or expression."""
    pad, word = " " * node.col_offset, lines[node.lineno - 1].split()[0]
    start, split, end = node.test.end_lineno or 0, node.body[-1].end_lineno or 0, node.end_lineno
    while not lines[start - 1].partition("  #")[0].endswith(":"):
        start += 1
    while split < (end or 0) and not lines[split].startswith((f"{pad}else:", f"{pad}elif ")):
        split += 1
    body, other = lines[start:split], lines[split:end]
    if isinstance(value, ast.expr):
        yield from (f"{pad}{word} {ast.unparse(value)}:", *body, *other)
    elif word == "elif":
        yield from (f"{pad}else:", *body) if value else other
    elif not value and other and other[0].startswith(f"{pad}elif "):
        yield from (pad + other[0].removeprefix(f"{pad}el"), *other[1:])
    else:
        kept = [line.removeprefix("    ") for line in (body if value else other[1:])]
        yield from kept
        if all(line.strip().startswith("#") or not line.strip() for line in kept):
            yield f"{pad}pass"
