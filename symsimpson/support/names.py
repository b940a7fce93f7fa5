"""Names that users give and ask for: what a key means, what was probably meant, and in which place.

A name of a symbol is any text; it is compared here, and shown, but never evaluated.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from symsimpson.errors import reject

#: How alike two names are that may have been mistaken for one another: as "th" and "theta".
ALIKE = 0.55


def did_you_mean(name: object, known: Iterable[str]) -> str:
    """Return a question that names the nearest of the known names, with a blank before it."""
    close = difflib.get_close_matches(str(name), list(known), n=1, cutoff=ALIKE)
    return f" Did you mean {close[0]}?" if close else ""


def constraint_called(name: str) -> str:
    """Return a constraint as messages name it: constraints of a list have numbers."""
    return f"number {name} of the list" if name.isdigit() else repr(name)


def speed_of_approach() -> Any:
    """Return the symbol of the speed at which a gap closes; SymPy is imported by who needs it."""
    from sympy import Symbol

    return Symbol("approach", nonnegative=True)


def shortened(value: object) -> str:
    """Return how a value is written, in some sixty characters."""
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."


def public_names(value: Any) -> list[str]:
    """Return names of attributes for ``dir``: no private ones, no fields that no repr shows."""
    internal = {x.name for x in value.__dataclass_fields__.values() if not x.repr}
    return [x for x in object.__dir__(value) if not x.startswith("_") and x not in internal]


def counted(count: int, what: str) -> str:
    """Return how many there are: "1 state", "2 states"."""
    return f"{count} {what}" if count == 1 else f"{count} {what}s"


def in_a_row(given: Any) -> tuple[Any, ...]:
    """Return what is given, or its name, in a row: one by itself is a row of one."""
    several = isinstance(given, Iterable) and not isinstance(given, str)
    return tuple(given) if several else (given,)


def is_masked(given: Any) -> bool:
    """Return whether a number is masked, as in arrays of numpy.ma, or one in lists of them."""
    if isinstance(given, (list, tuple)):
        return not {float, int}.issuperset(map(type, given)) and any(map(is_masked, given))
    return isinstance(given, np.ma.MaskedArray) and bool(np.ma.is_masked(given))


def by_name(given: Any) -> Any:
    """Return rows and tables whose labels are names, as those of pandas, as a mapping.

    All else stays as it is: labels that are numbers are places in an order.
    """
    keys = getattr(given, "keys", None)
    if isinstance(given, (Mapping, type)) or not callable(keys):
        return given
    labels = list(keys())
    names = all(isinstance(key, str) or hasattr(key, "free_symbols") for key in labels)
    return {key: given[key] for key in labels} if names else given


def read_mapping(what: str, given: Any, example: str) -> Mapping[Any, Any]:
    """Return values by name, none where none are given.

    Raises InputError if what is given is no mapping.
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
    """Return the name that a key means: a text itself, symbols and functions of time by theirs.

    The velocity of a coordinate, a derivative, is called ``v_`` and the coordinate.
    """
    if isinstance(key, str):
        return key.removesuffix("(t)")
    if getattr(key, "derivative_count", 0) == 1:
        return f"v_{spelled(key.expr)}"
    name = getattr(key, "name", None)
    return name if isinstance(name, str) else str(key).removesuffix("(t)")


class Named:
    """Things in an order, by the names that a user gave them and by those of a module.

    ``what`` says what one of them is, as "coordinate"; of each the name that a user gave comes
    first.
    """

    def __init__(self, what: str, names: Sequence[str], users: Iterable[str] | None = None) -> None:
        self.what, self.own = what, tuple(names)
        self.shown = self.own if users is None else tuple(users)
        self.places = {name: i for i, name in enumerate(self.own)}
        self.places |= {name: i for i, name in enumerate(self.shown)}

    def __len__(self) -> int:
        return len(self.shown)

    def place(self, key: Any) -> int | None:
        """Return the place of what a name or a symbol means; None if it is none of them."""
        return self.places.get(spelled(key))

    def found(self, key: Any) -> int:
        """Return the place of what a name or a symbol means; InputError if it is none of them."""
        place = self.place(key)
        if place is None:
            reject(self.unknown(key))
        return place

    def by_place(self, given: Mapping[Any, Any], what: str = "") -> dict[int, Any]:
        """Return values by the places of what their names or symbols mean.

        Names of velocities are known in "v0", names of momenta in "p0". Raises InputError if there
        is no such thing, or a value is given twice.
        """
        values: dict[int, Any] = {}
        where = f"{what}: " if what else ""
        for key, value in given.items():
            place = self.place_of_velocity(key) if what == "v0" else None
            place = self._place_behind("p_", key) if what == "p0" else place
            place = self.place(key) if place is None else place
            if place is None:
                reject(f"{where}{self.unknown(key)}")
            if place in values:
                reject(
                    f"{where}{self.what} {self.shown[place]} is given twice, by name and "
                    "by symbol.",
                    remedy="Give it once.",
                )
            values[place] = value
        return values

    def unknown(self, key: Any) -> str:
        """Say that there is no such thing, and which there are."""
        name = spelled(key)
        return (
            f"there is no {self.what} {shortened(name)}.{did_you_mean(name, self.shown)}\n"
            f"The system has {', '.join(self.shown) or 'none'}."
        )

    def place_of_velocity(self, key: Any) -> int | None:
        """Return the place of the coordinate whose velocity a key names; None if it names none."""
        if getattr(key, "derivative_count", 0) == 1:
            return self.place(key.expr)
        return self._place_behind("v_", key)

    def _place_behind(self, prefix: str, key: Any) -> int | None:
        """Return the place of the coordinate whose name stands behind a prefix, None of others."""
        name = spelled(key)
        if name in self.places or not name.startswith(prefix):  # a coordinate's own name is first
            return None
        return self.places.get(name.removeprefix(prefix))

    def in_order(self, what: str, given: Any) -> Any:
        """Return values that are given by name as a list in order; all others as they are.

        Those of "v0" may be given by the names of velocities, too, those of "p0" by the names of
        momenta. A row of a table, as of pandas, whose labels are names gives values by name. Raises
        InputError if a name is unknown, is given twice, or is missing.
        """
        given = by_name(given)
        if not isinstance(given, Mapping):
            return given
        values = self.by_place(given, what)
        missing = [name for i, name in enumerate(self.shown) if i not in values]
        if missing:
            reject(
                f"{what} has no number for {', '.join(missing)}.",
                remedy=f"Give one for each {self.what}: {', '.join(self.shown)}.",
            )
        return [values[i] for i in range(len(self.shown))]
