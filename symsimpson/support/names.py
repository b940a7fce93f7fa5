"""Names of the user: texts, symbols and their places in an order.

The name of a symbol can be any text. This module compares and shows names, but never evaluates
them.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from symsimpson.errors import reject

#: Least similarity of a suggested name: "th" and "theta" are above it.
ALIKE = 0.55


def did_you_mean(name: object, known: Iterable[str]) -> str:
    """Return " Did you mean ...?" with the nearest known name, or an empty text."""
    close = difflib.get_close_matches(str(name), list(known), n=1, cutoff=ALIKE)
    return f" Did you mean {close[0]}?" if close else ""


def constraint_called(name: str) -> str:
    """Return a constraint as messages name it: by its name, or by its number in the list."""
    return f"number {name} of the list" if name.isdigit() else repr(name)


def speed_of_approach() -> Any:
    """Return the symbol of the speed at which a gap closes."""
    from sympy import Symbol  # here, because SymPy is slow to import

    return Symbol("approach", nonnegative=True)


def shortened(value: object) -> str:
    """Return the ``repr`` of a value, cut to at most 60 characters."""
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."


def public_names(value: Any) -> list[str]:
    """Return the names of attributes for ``dir``, without private names and hidden fields."""
    internal = {x.name for x in value.__dataclass_fields__.values() if not x.repr}
    return [x for x in object.__dir__(value) if not x.startswith("_") and x not in internal]


def counted(count: int, what: str) -> str:
    """Return a count with its noun: "1 state", "2 states"."""
    return f"{count} {what}" if count == 1 else f"{count} {what}s"


def as_tuple(given: Any) -> tuple[Any, ...]:
    """Return an iterable as a tuple, and a text or any other single value as a tuple of one."""
    several = isinstance(given, Iterable) and not isinstance(given, str)
    return tuple(given) if several else (given,)


def is_masked(given: Any) -> bool:
    """Return whether any number is masked, in an array of numpy.ma or in nested lists."""
    if isinstance(given, (list, tuple)):
        return not {float, int}.issuperset(map(type, given)) and any(map(is_masked, given))
    return isinstance(given, np.ma.MaskedArray) and bool(np.ma.is_masked(given))


def as_mapping(given: Any) -> Any:
    """Return a row or a table with names as labels, as of pandas, as a mapping.

    Any other value is returned unchanged. Labels that are numbers mean places in an order.
    """
    keys = getattr(given, "keys", None)
    if isinstance(given, (Mapping, type)) or not callable(keys):
        return given
    labels = list(keys())
    names = all(isinstance(key, str) or hasattr(key, "free_symbols") for key in labels)
    return {key: given[key] for key in labels} if names else given


def read_mapping(what: str, given: Any, example: str) -> Mapping[Any, Any]:
    """Return a mapping of the user, or an empty one for None.

    Raises InputError for any other type. ``example`` is a name for the message.
    """
    if given is None:
        return {}
    if not isinstance(given, Mapping):
        reject(
            f"{what} is {shortened(given)}, not a mapping.",
            remedy=f"Pass {what}={{'{example}': 1.0}}.",
        )
    return given


def spelled(key: Any) -> str:
    """Return the name of a key: a text, a symbol, or a function of time without its "(t)".

    The first derivative of a coordinate x has the name "v_x".
    """
    if isinstance(key, str):
        return key.removesuffix("(t)")
    if getattr(key, "derivative_count", 0) == 1:
        return f"v_{spelled(key.expr)}"
    name = getattr(key, "name", None)
    return name if isinstance(name, str) else str(key).removesuffix("(t)")


class NameTable:
    """A table of names and places. Each place has a name of the user and a name of the module.

    ``what`` is the noun for messages, such as "coordinate". If a name of the user equals a name of
    the module for another place, the name of the user has priority.
    """

    def __init__(self, what: str, names: Sequence[str], users: Iterable[str] | None = None) -> None:
        self.what, self.own = what, tuple(names)
        self.shown = self.own if users is None else tuple(users)
        self.places = {name: i for i, name in enumerate(self.own)}
        self.places |= {name: i for i, name in enumerate(self.shown)}

    def __len__(self) -> int:
        return len(self.shown)

    def place(self, key: Any) -> int | None:
        """Return the place of a name or a symbol; None if the table does not have it."""
        return self.places.get(spelled(key))

    def found(self, key: Any) -> int:
        """Return the place of a name or a symbol. Raises InputError if the table lacks it."""
        place = self.place(key)
        if place is None:
            reject(self.unknown(key))
        return place

    def values_by_place(self, given: Mapping[Any, Any], what: str = "") -> dict[int, Any]:
        """Return a mapping from places to values.

        ``what`` is the argument. "v0" accepts names of velocities, too, and "p0" names of momenta.
        Raises InputError if a name is unknown, or if a place gets two values.
        """
        values: dict[int, Any] = {}
        for key, value in given.items():
            place = self.place_of_velocity(key) if what == "v0" else None
            place = self._place_with_prefix("p_", key) if what == "p0" else place
            place = self.place(key) if place is None else place
            if place is None:
                reject(self.unknown(key), where=what)
            if place in values:
                reject(
                    f"{self.what} {self.shown[place]} is given twice, by name and by symbol.",
                    where=what,
                    remedy="Give it once.",
                )
            values[place] = value
        return values

    def unknown(self, key: Any) -> str:
        """Return the message for an unknown name, with the names that the table has."""
        name = spelled(key)
        return (
            f"there is no {self.what} {shortened(name)}.{did_you_mean(name, self.shown)}\n"
            f"The system has {', '.join(self.shown) or 'none'}."
        )

    def place_of_velocity(self, key: Any) -> int | None:
        """Return the place of the coordinate of a velocity; None if the key is no velocity."""
        if getattr(key, "derivative_count", 0) == 1:
            return self.place(key.expr)
        return self._place_with_prefix("v_", key)

    def _place_with_prefix(self, prefix: str, key: Any) -> int | None:
        """Return the place of a coordinate from its name with a prefix, such as "v_x"."""
        name = spelled(key)
        if name in self.places or not name.startswith(prefix):  # "v_x" may itself be a coordinate
            return None
        return self.places.get(name.removeprefix(prefix))

    def in_order(self, what: str, given: Any) -> Any:
        """Return a mapping by name as a list in the order of the table.

        ``what`` is the argument. "v0" accepts names of velocities, too, and "p0" names of momenta.
        A row of a table with names as labels, as of pandas, counts as a mapping. Any other value is
        returned unchanged. Raises InputError if a name is unknown, repeated or missing.
        """
        given = as_mapping(given)
        if not isinstance(given, Mapping):
            return given
        values = self.values_by_place(given, what)
        missing = [name for i, name in enumerate(self.shown) if i not in values]
        if missing:
            reject(
                f"{what} has no number for {', '.join(missing)}.",
                remedy=f"Give one number for each {self.what}: {', '.join(self.shown)}.",
            )
        return [values[i] for i in range(len(self.shown))]
