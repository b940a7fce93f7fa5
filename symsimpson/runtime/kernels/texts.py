"""Texts of modules on disk, under what they follow from: deriving them again is skipped."""

from __future__ import annotations

import contextlib
import hashlib
import json
from collections.abc import Callable, Iterable
from functools import cache
from importlib import resources
from importlib.resources.abc import Traversable

from symsimpson.derivation import Derivation
from symsimpson.errors import StorageError
from symsimpson.files import written_beside
from symsimpson.runtime.kernels.cache import cache_folder

__all__ = ["kept"]

#: What the generator is made of.
GENERATOR = ("graph", "mechanics", "schemes", "discrete", "codegen", "interface.py")
#: A derivation that took less, in seconds, is as soon done again as read.
BRIEF = 0.1


def kept(source: Iterable[str], derive: Callable[[], Derivation]) -> Derivation:
    """Return the derivation that was kept for the same source, or make it and keep it.

    Parameters
    ----------
    source : iterable of str
        All that the text follows from, beside the generator itself.
    derive : callable

    Returns
    -------
    Derivation
        Its stages took no time where it was kept.
    """
    content = "\n".join([_generator(), *source])
    place = cache_folder() / "texts" / f"{hashlib.sha256(content.encode()).hexdigest()}.json"
    try:
        found = json.loads(place.read_text(encoding="utf-8"))
        text = found["text"]
        if hashlib.sha256(text.encode()).hexdigest() == found["sha256"]:
            seconds = dict.fromkeys(map(str, found["stages"]), 0.0)
            return Derivation(text, seconds, found["operations"], found["unrolled"] is True)
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        pass  # there is none, or none that is whole
    made = derive()
    if sum(made.seconds.values()) > BRIEF:
        with contextlib.suppress(StorageError, OSError):  # a full disk keeps nothing
            place.parent.mkdir(mode=0o700, exist_ok=True)
            digest = hashlib.sha256(made.text.encode()).hexdigest()
            whole_of_it = {
                "text": made.text, "sha256": digest, "operations": made.operations,
                "unrolled": made.unrolled, "stages": [*made.seconds],
            }  # fmt: skip
            with written_beside(place, "text") as whole:
                whole.write_text(json.dumps(whole_of_it), encoding="utf-8")
    return made


@cache
def _generator() -> str:
    """Return what tells this generator from others, which may write other texts."""
    package, digest = resources.files("symsimpson"), hashlib.sha256()
    for name in GENERATOR:
        for file in _files(package.joinpath(name)):
            digest.update(file.read_bytes())
    return digest.hexdigest()


def _files(place: Traversable) -> list[Traversable]:
    if place.is_file():
        return [place] if place.name.endswith(".py") else []
    return [x for one in sorted(place.iterdir(), key=lambda x: x.name) for x in _files(one)]
