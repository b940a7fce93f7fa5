"""Answers on disk, under what they follow from: the same question is not asked again."""

from __future__ import annotations

import contextlib
import json
import logging
from collections.abc import Callable
from typing import Any, Literal, TypeVar, get_args

from symsimpson.errors import StorageError, SymsimpsonError
from symsimpson.module.header import digest
from symsimpson.program.cache import cache_folder
from symsimpson.support.files import written_beside

#: Folders of answers, beside compiled code.
Kind = Literal["choices", "texts"]
KINDS = get_args(Kind)
Answer = TypeVar("Answer")
LOG = logging.getLogger(__name__)
#: What a file may raise that is not there, not whole, or not what it should be.
DAMAGE = (OSError, ValueError, KeyError, TypeError, AttributeError, SymsimpsonError)


def kept(
    kind: Kind,
    question: str,
    read: Callable[[Any], Answer],
    make: Callable[[], Answer],
    write: Callable[[Answer], Any],
) -> Answer:
    """Return the answer that was kept for the same question, or make it and keep it.

    ``kind`` is the folder of such answers, beside compiled code; ``question`` is all that the
    answer follows from. ``read`` makes the answer of what JSON holds, and raises an error of
    ``DAMAGE`` if that makes no sense; ``write`` returns what is to be kept, for JSON, or None if it
    is not worth it.
    """
    place = cache_folder() / kind / f"{digest(question)}.json"
    try:
        answer = read(json.loads(place.read_text(encoding="utf-8")))
        LOG.info("%s: taken from the cache, %s", kind, place)
        return answer
    except FileNotFoundError:
        pass
    except DAMAGE as error:
        LOG.info("%s: %s is damaged, and made again: %s", kind, place, error)
    answer = make()
    content = write(answer)
    if content is not None:
        with contextlib.suppress(StorageError, OSError):  # a full disk keeps nothing
            place.parent.mkdir(mode=0o700, exist_ok=True)
            with written_beside(place, "answer") as whole:
                whole.write_text(json.dumps(content), encoding="utf-8")
            LOG.info("%s: remembered in %s", kind, place)
    return answer
