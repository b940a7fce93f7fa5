"""The constants and functions that a module's text defines, and texts in which some are others."""

from __future__ import annotations

import ast
from collections.abc import Mapping
from functools import lru_cache
from types import MappingProxyType

__all__ = ["definitions", "first_line", "outline", "redefined", "syntax"]


@lru_cache(maxsize=1)  # trees are large, and asked for by one reader after the other
def syntax(text: str) -> ast.Module:
    """Return the syntax tree of a text, which is not to be changed."""
    return ast.parse(text)


@lru_cache(maxsize=8)  # small trees
def outline(text: str) -> ast.Module:
    """Return the syntax tree of a text without the bodies of its functions, in a tenth of the time.

    Lines keep their numbers. A body is what is indented behind a function's arguments: a string
    in it must not go on at the left margin.
    """
    kept: list[str] = []
    last = depth = 0  # the last line of a body; how many brackets of arguments are open
    inside = False
    for line in text.splitlines():
        if inside and not depth and (not line or line[0].isspace()):
            if line.strip():
                last = len(kept)
            kept.append("")
            continue
        if inside and not depth and last:
            kept[last], last = "    ...", 0
        inside = (inside and depth > 0) or line.startswith("def ")
        if inside:
            depth += line.count("(") - line.count(")")
        kept.append(line)
    if last:
        kept[last] = "    ..."
    return ast.parse("\n".join(kept))


def first_line(node: ast.stmt) -> int:
    """Return the line in which a statement begins, counted from 1; decorators belong to it."""
    return min([node.lineno, *(mark.lineno for mark in getattr(node, "decorator_list", ()))])


@lru_cache(maxsize=64)  # each ensemble and each search for events asks again
def definitions(text: str) -> Mapping[str, tuple[int, int]]:
    """Return the first line, and the line behind the last, of each constant and function.

    Decorators belong to functions. Lines are counted from 0. Raises SyntaxError, ValueError,
    RecursionError or MemoryError if the text is no Python.
    """
    spans = {}
    for node in outline(text).body:
        match node:
            case ast.FunctionDef(name=name) | ast.Assign(targets=[ast.Name(id=name)]):
                first = first_line(node)
                spans[name] = first - 1, node.end_lineno or first
    return MappingProxyType(spans)


def redefined(text: str, changes: Mapping[str, str]) -> str:
    """Return a text in which constants and functions have other definitions.

    ``changes`` has the definition of each name as it is to stand there; empty to leave it out.
    """
    lines = text.splitlines(keepends=True)
    spans = definitions(text)
    for name in sorted(changes, key=lambda name: spans[name], reverse=True):
        first, end = spans[name]
        lines[first:end] = [f"{changes[name]}\n"] if changes[name] else []
    return "".join(lines)
