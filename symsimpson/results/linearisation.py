"""The steps of a run as linear maps: how each of them ends, by how it began and by its inputs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from symsimpson.support.array_types import Reals
from symsimpson.support.names import counted

__all__ = ["Linearisation"]


@dataclass(frozen=True)
class Linearisation:
    """Derivatives of the steps of a run, each of its end (q, p).

    Attributes
    ----------
    t : ndarray, shape (N + 1,)
    q, p : ndarray, shape (N + 1, n)
        The states between which the steps are.
    by_state : ndarray, shape (N, 2 n, 2 n)
        By (q, p) at the start of each step.
    by_parameter : mapping from name to ndarray, shape (N, 2 n)
        By a parameter, at a given state.
    by_input : mapping from name to ndarray, shape (N, 2 n, s)
        By the values that an input has at the s nodes of each step.

    Examples
    --------
    >>> import symsimpson as ss
    >>> stepper = ss.compile(ss.systems.cart_pole())
    >>> run = stepper.linearise([0.0, 0.1], p0=[0.0, 0.0], h=0.01, steps=5, wrt="l")
    >>> run.by_state.shape, run.by_parameter["l"].shape
    ((5, 4, 4), (5, 4))
    """

    t: Reals
    q: Reals
    p: Reals
    by_state: Reals
    by_parameter: Mapping[str, Reals]
    by_input: Mapping[str, Reals]

    def __repr__(self) -> str:
        names = ", ".join((*self.by_parameter, *self.by_input))
        steps = counted(len(self.by_state), "step")
        return f"Linearisation({steps}, by the state{', ' * bool(names)}{names})"
