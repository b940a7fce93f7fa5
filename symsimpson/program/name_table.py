"""The one table of names of what a stepper computes."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from functools import cached_property
from itertools import chain
from typing import Any

from symsimpson.errors import ModelWarning
from symsimpson.support.calling import warn
from symsimpson.support.names import Named, spelled
from symsimpson.text.header import Header


class Names:
    """Names of all that a module has; a user's own names come before those of the module.

    A module writes names as identifiers alone. Those that a user gave are known where the system is
    that it was made of; a module from a file has none but its own.
    """

    def __init__(
        self,
        header: Header,
        declared: Any,
        defaults: Mapping[str, Any] | None,
        users: Mapping[str, Any] | None = None,
    ) -> None:
        self._declared, given = declared, dict(users or {})
        if declared is not None:
            plain = declared.plain
            given = {"coordinates": declared.coordinates, "inputs": declared.inputs}
            given |= {"constraints": plain.held, "forces": plain.forces}
            given |= {"invariants": plain.invariants, "units": getattr(declared, "units", {})}
        if defaults is not None:
            given["parameters"] = defaults

        def named(attribute: str, identifiers: tuple[str, ...]) -> Named:
            users = [spelled(key) for key in given.get(attribute, ())]
            fits = len(users) == len(identifiers)
            return Named(attribute.removesuffix("s"), identifiers, users if fits else None)

        self.coordinates = named("coordinates", header.coordinates)
        self.parameters = named("parameters", header.parameters)
        self.inputs = named("inputs", header.inputs)
        self.constraints = named("constraints", header.constraints)
        self.forces = named("forces", header.forces)
        self.invariants = named("invariants", header.invariants)
        self.units = {str(name): str(unit) for name, unit in dict(given.get("units", {})).items()}

    @property
    def users(self) -> dict[str, Any]:
        """Units, and the names that a user gave where they are not the module's; for files."""
        tables = {name: x for name, x in vars(self).items() if isinstance(x, Named)}
        names = {name: [*x.shown] for name, x in tables.items() if x.shown != x.own}
        return names | ({"units": self.units} if self.units else {})

    @cached_property
    def idle(self) -> frozenset[int]:
        """Places of parameters that stand in no expression, as far as the system is known."""
        if self._declared is None:
            return frozenset()
        plain = self._declared.plain
        rows = (plain.a, *plain.forces.values(), plain.held_values)
        values = [plain.T, plain.V, *plain.M.values(), *plain.invariants.values(), *chain(*rows)]
        used = {n for _, node in values for n in plain.graph.nodes[node].symbols}
        drawn: set[Any] = set()
        for point in (self._declared.positions or {}).values():
            corners = point if isinstance(point[0], tuple) else (point,)
            drawn.update(*(x.free_symbols for x in chain(*corners)))
        parameters = zip(self._declared.parameters, plain.numbers(plain.parameters), strict=True)
        return frozenset(
            i for i, (symbol, n) in enumerate(parameters) if n not in used and symbol not in drawn
        )

    def warn_of_idle(self, system: str, changed: Iterable[int], beside: Any = None) -> None:
        """Warn where values are given to parameters that stand in no expression.

        They may stand ``beside`` the system, in events of a run or in what is observed of it.
        """
        idle = [self.parameters.shown[i] for i in sorted(self.idle.intersection(changed))]
        pattern = re.compile(
            "|".join(rf"(?<!\w){re.escape(name)}(?!\w)" for name in idle) or "(?!)"
        )
        idle = [name for name in idle if name not in pattern.findall(str(beside))]
        if idle:
            verb = "stand" if len(idle) > 1 else "stands"
            warn(
                f"{system}: {', '.join(idle)} {verb} in no expression of the system, so that other "
                "values have no effect.\nA term that was forgotten in T, V or the forces is the "
                "usual cause.",
                ModelWarning,
            )

    def varied(self, names: Iterable[str]) -> tuple[str, ...]:
        """Return what a user calls parameters and inputs that have these names in the module."""
        parameters, inputs = self.parameters, self.inputs
        known = dict(zip(parameters.own + inputs.own, parameters.shown + inputs.shown, strict=True))
        return tuple(known.get(name, name) for name in names)
