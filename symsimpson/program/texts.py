"""Texts of modules on disk, under what they follow from: deriving them again is skipped."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable
from functools import cache
from importlib import resources
from importlib.resources.abc import Traversable
from typing import Any

from symsimpson.module.header import digest
from symsimpson.program.answers import kept
from symsimpson.support.derivation import Derivation

#: What the generator is made of.
GENERATOR = ("graph", "mechanics", "schemes", "discrete", "codegen", "module")
#: A derivation that took less, in seconds, is as soon done again as read.
BRIEF = 0.1


def kept_text(source: Iterable[str], derive: Callable[[], Derivation]) -> Derivation:
    """Return the derivation that was kept for the same source, or make it and keep it.

    The ``source`` is all that the text follows from, beside the generator itself. Stages of the
    derivation took no time where it was kept.
    """
    return kept("texts", "\n".join([_generator(), *source]), _read, derive, _content)


def _read(content: Any) -> Derivation:
    text = content["text"]
    if digest(text) != content["sha256"]:
        raise ValueError("the text does not have the digest that it names")
    seconds = dict.fromkeys(map(str, content["stages"]), 0.0)
    return Derivation(text, seconds, content["operations"], content["unrolled"] is True)


def _content(derivation: Derivation) -> dict[str, Any] | None:
    if sum(derivation.seconds.values()) <= BRIEF:
        return None
    return {
        "text": derivation.text,
        "sha256": digest(derivation.text),
        "operations": derivation.operations,
        "unrolled": derivation.unrolled,
        "stages": [*derivation.seconds],
    }


@cache
def _generator() -> str:
    """Return what tells this generator from others, which may write other texts."""
    package, content = resources.files("symsimpson"), hashlib.sha256()
    for name in GENERATOR:
        for file in _files(package.joinpath(name)):
            content.update(file.read_bytes())
    return content.hexdigest()


def _files(place: Traversable) -> list[Traversable]:
    if place.is_file():
        return [place] if place.name.endswith(".py") else []
    return [x for entry in sorted(place.iterdir(), key=lambda x: x.name) for x in _files(entry)]
