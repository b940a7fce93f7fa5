"""Figures of the package that may only fall."""

import ast
import graphlib
import json
import os
import re
import subprocess
import sys
from collections import Counter
from functools import cache

import pytest
from support.imports import imports, room_of
from support.places import PACKAGE, TESTS

FILES = sorted(PACKAGE.rglob("*.py"))
SPOKEN = ast.FunctionDef | ast.ClassDef | ast.Module
#: Words that have a meaning of their own here, and which a newcomer has to guess.
PRIVATE_WORDS = re.compile(
    r"\b(held|told|behind|come to|came to|by itself|by themselves|so many|those of|that of|of which"
    r"|asked for|is asked|in words|begin anew|anew|aside|made of|stands? (?:in|for|beside|there)"
    r"|as (?:those|that) of|warned of|some \d|lean on|leaves? out|is left|goes on|gone through)\b"
)


@cache
def every_node():
    return tuple(x for path in FILES for x in ast.walk(ast.parse(path.read_text("utf-8"))))


@cache
def nodes(kind):
    return [x for x in every_node() if isinstance(x, kind)]


def with_more_arguments(most):
    sizes = ("posonlyargs", "args", "kwonlyargs")
    return sum(sum(len(getattr(f.args, x)) for x in sizes) > most for f in nodes(ast.FunctionDef))


def is_reach(node):
    """Whether a private name is asked of something other than one's own."""
    own = isinstance(node.value, ast.Name) and node.value.id in ("self", "cls")
    return node.attr.startswith("_") and not node.attr.startswith("__") and not own


def is_vague(node):
    """Whether a value has a name that says nothing of it."""
    named = {ast.Name: "id", ast.arg: "arg", ast.MatchAs: "name"}.get(type(node), "")
    read = isinstance(node, ast.Name) and isinstance(node.ctx, ast.Load)
    return not read and getattr(node, named, "") in ("found", "made", "own", "one")


def repeated_names():
    """Count the names that several files have, but those of packages."""
    names = [path.name for path in FILES if path.name != "__init__.py"]
    return len({name for name in names if names.count(name) > 1})


def room(path):
    """Return the folder of the package in which a file lies, or the file at its root."""
    return path.relative_to(PACKAGE).parts[0].removesuffix(".py")


@cache
def lines_of_rooms():
    """Count the lines of all text files, room by room."""
    lines = Counter()
    for path in PACKAGE.rglob("*"):
        if path.is_file() and "__pycache__" not in path.parts:
            lines[room(path) if path.parent != PACKAGE else "root"] += path.read_text().count("\n")
    return lines


def floors():
    """Return the length of the longest chain of rooms, each imported by the next."""
    below = {}
    for path in FILES:
        imported = set(map(room_of, imports(path, deferred=False)))
        below.setdefault(room_of(path), set()).update(imported - {room_of(path)})
    floor = {}
    for name in graphlib.TopologicalSorter(below).static_order():
        floor[name] = 1 + max((floor[lower] for lower in below.get(name, ())), default=0)
    return max(floor.values())


def repeated_classes():
    """Count the names that several classes have."""
    names = Counter(x.name for x in nodes(ast.ClassDef))
    return sum(count > 1 for count in names.values())


def private_words():
    """Count the docstrings that contain a word with a private meaning."""
    return sum(bool(PRIVATE_WORDS.search(ast.get_docstring(x) or "")) for x in nodes(SPOKEN))


@cache
def first_calls(cache_folder):
    """Count what a first compile and a first integrate execute, and the modules loaded then."""
    path = os.pathsep.join([str(PACKAGE.parent), os.environ.get("PYTHONPATH", "")])
    given = {**os.environ, "SYMSIMPSON_CACHE_DIR": cache_folder, "PYTHONPATH": path}
    given.pop("SYMSIMPSON_COMPILE", None)
    program = [sys.executable, str(TESTS / "support" / "first_calls.py")]
    done = subprocess.run(program, env=given, capture_output=True, text=True, check=True)
    return json.loads(done.stdout)


#: Lines of text in each room.
LINES = {
    "api": 2605,
    "cli": 800,
    "declare": 9630,
    "discrete": 1902,
    "graph": 2343,
    "lower": 6126,
    "plotting": 1102,
    "program": 3058,
    "reference": 1010,
    "results": 4213,
    "root": 623,
    "run": 9655,
    "schemes": 790,
    "stepping": 2507,
    "study": 13100,
    "support": 1369,
    "systems": 1915,
    "targets": 4606,
    "text": 7937,
}

#: What a first compile and a first integrate execute, with nothing on disk. Python 3.11 counts
#: comprehensions as functions.
FIRST_CALLS = {
    "functions that a first compile executes": 1126,
    "files that a first compile executes": 125,
    "functions that a first integrate executes": 663,
    "files that a first integrate executes": 83,
    "modules loaded after ten steps": 198,
}

#: Figures as they are. One that has fallen is written here, so that it cannot rise again.
FIGURES = {
    "lines that no formatter may touch": (
        0,
        lambda: sum("# fmt: skip" in x for p in FILES for x in p.read_text().splitlines()),
    ),
    "functions with more than 8 arguments": (19, lambda: with_more_arguments(8)),
    "functions with more than 12 arguments": (9, lambda: with_more_arguments(12)),
    "private names asked of others": (27, lambda: sum(map(is_reach, nodes(ast.Attribute)))),
    "values called found, made, own or one": (0, lambda: sum(map(is_vague, every_node()))),
    "names that several files have": (1, repeated_names),
    "modules at the root": (3, lambda: len(list(PACKAGE.glob("*.py")))),
    "lines of the package": (75291, lambda: sum(lines_of_rooms().values())),
    "files": (327, lambda: len(FILES)),
    "floors": (10, floors),
    "class names that occur twice": (6, repeated_classes),
    "docstrings with private words": (32, private_words),
    "docstrings that cannot be read alone": (
        0,
        lambda: sum(
            (ast.get_docstring(x) or "").startswith(("Do so", "What")) for x in nodes(SPOKEN)
        ),
    ),
}


@pytest.mark.slow
def test_no_figure_has_risen():
    """All of them at a time: cases are drawn by the day, and these must be seen on each."""
    found = {name: count() for name, (_, count) in FIGURES.items()}
    told = {name: known for name, (known, _) in FIGURES.items()}
    risen = {name: (told[name], n) for name, n in found.items() if n > told[name]}
    assert not risen, "these have risen"
    assert found == told, "some have fallen: write that in FIGURES"


@pytest.mark.slow
def test_no_room_has_grown():
    assert lines_of_rooms() == LINES, "a room has grown, or shrunk: write that in LINES"


@pytest.mark.slow
def test_a_first_call_executes_no_more(tmp_path):
    counted = dict(zip(FIRST_CALLS, first_calls(str(tmp_path)), strict=True))
    risen = {name: n for name, n in counted.items() if n > FIRST_CALLS[name]}
    assert not risen, "these have risen"
