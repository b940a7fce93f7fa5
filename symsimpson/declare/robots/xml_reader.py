"""XML files of robots: elements with the lines where they begin."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass, field
from difflib import get_close_matches
from typing import Any
from xml.parsers import expat

import numpy as np

from symsimpson.declare.robots.tree import reject_robot
from symsimpson.errors import ModelWarning, StorageError, reject
from symsimpson.support.array_types import Floats
from symsimpson.support.calling import warn
from symsimpson.support.files import read_path

#: The largest file and the largest number of elements. Larger files are mistakes or attacks.
MOST_BYTES, MOST_ELEMENTS = 10 * 2**20, 10_000
#: Names that are more alike than this are probably misspelled.
SIMILAR = 0.8


@dataclass
class Element:
    """An element of an XML file."""

    file: str
    tag: str
    attributes: dict[str, str]
    line: int
    children: list[Element] = field(default_factory=list)

    @property
    def where(self) -> str:
        """The line and the element, for messages."""
        name = self.attributes.get("name")
        return f"line {self.line}, <{self.tag}{'' if name is None else f' name={name!r}'}>"

    def all(self, tag: str) -> Iterator[Element]:
        """Return the children with a tag."""
        return (x for x in self.children if x.tag == tag)

    def first(self, tag: str) -> Element | None:
        """Return the first child with a tag."""
        return next(self.all(tag), None)

    def warn_of_typos(self, tags: str, attributes: str) -> None:
        """Warn of children and attributes whose names resemble known names."""
        for what, given, known in (
            ("element", [x.tag for x in self.children], tags.split()),
            ("attribute", [*self.attributes], attributes.split()),
        ):
            for name in given:
                near = get_close_matches(name, known, 1, SIMILAR)
                if name not in known and near:
                    warn(
                        f"{self.file}, {self.where}: the {what} {name!r} is ignored. Did you mean "
                        f"{near[0]}?",
                        ModelWarning,
                    )

    def text(self, name: str) -> str:
        """Return an attribute that must be there."""
        if not self.attributes.get(name, "").strip():
            reject_robot(self.file, f"it has no attribute {name!r}.", self.where)
        return self.attributes[name]

    def numbers(self, name: str, default: tuple[float, ...]) -> Floats:
        """Return an attribute of as many finite numbers as the default has."""
        given = self.attributes.get(name)
        if given is None:
            return np.array(default)
        try:
            values = np.array([float(x) for x in given.split()])
        except ValueError:
            values = np.zeros(0)
        if len(values) != len(default) or not np.isfinite(values).all():
            count = f"{len(default)} finite numbers" if len(default) > 1 else "a finite number"
            reject_robot(self.file, f"{name} is {given[:80]!r}, not {count}.", self.where)
        return values

    def number(self, name: str, default: float | None = None) -> float:
        """Return an attribute that is a finite number; it must be there without a default."""
        if default is None:
            self.text(name)
        return float(self.numbers(name, (default or 0.0,))[0])


def read_text(path_or_text: Any) -> tuple[str, str]:
    """Return the name of a file for messages, and its text. A text begins with "<"."""
    if isinstance(path_or_text, str) and path_or_text.lstrip().startswith("<"):
        return "the given text", path_or_text
    place = read_path("path_or_text", path_or_text)
    try:
        if place.stat().st_size > MOST_BYTES:
            reject_robot(str(place), f"the file has more than {MOST_BYTES >> 20} MB.")
        return os.fspath(place), place.read_text(encoding="utf-8", errors="replace")
    except OSError as error:
        reject(
            f"the file cannot be read: {error.strerror}.",
            where=str(place),
            remedy='Pass the path of a file, or its text, which begins with "<".',
            error=StorageError,
        )


def parse(file: str, text: str) -> Element:
    """Parse a text. Raises ModelError if it is not XML, or declares entities."""
    if len(text) > MOST_BYTES:
        reject_robot(file, f"the text has more than {MOST_BYTES >> 20} MB.")
    parser, count = expat.ParserCreate(), 0
    whole = Element(file, "", {}, 0)
    path = [whole]

    def begin(tag: str, attributes: dict[str, str]) -> None:
        nonlocal count
        count += 1
        if count > MOST_ELEMENTS:
            reject_robot(file, f"it has more than {MOST_ELEMENTS} elements.")
        element = Element(file, tag, attributes, parser.CurrentLineNumber)
        path[-1].children.append(element)
        path.append(element)

    def reject_entity(name: str, *_: Any) -> None:
        line = f"line {parser.CurrentLineNumber}"
        reject_robot(file, f"it declares the entity {name!r}.", line, "Write the text itself.")

    parser.StartElementHandler = begin
    parser.EndElementHandler = lambda tag: path.pop()
    parser.EntityDeclHandler = reject_entity
    try:
        parser.Parse(text.encode(), True)
    except expat.ExpatError as error:
        reason = expat.errors.messages.get(error.code, "a mistake")
        if len(path) > 1 and reason == "no element found":
            reason = f"the closing tag </{path[-1].tag}> is missing"
        reject_robot(file, f"it is not XML: {reason}.", f"line {error.lineno}")
    return whole.children[0]
