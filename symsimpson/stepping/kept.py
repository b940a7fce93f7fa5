"""States of a run that were kept, at equal strides."""

from __future__ import annotations

from typing import NamedTuple

from symsimpson.support.array_types import Ints, Reals


class KeptStates(NamedTuple):
    """States of a run at equal strides; the last one may stand behind a part of a stride."""

    #: Both of shape (N, n).
    q: Reals
    p: Reals
    #: Since the state before, shape (N,); or, of a run of which none is asked for, all of them,
    #: shape (1,).
    iterations: Ints
    recorded: Reals  #: What recorders left beside them, shape (N, k).
    every: int  #: Steps from one to the next; 0 where none were kept.
