"""Costs of a step, counted in the text of the modules that are generated for a system."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from symsimpson.api.compiling import check_system
from symsimpson.declare.system import MechanicalSystem
from symsimpson.lower.pipeline import source
from symsimpson.support import markup
from symsimpson.support.names import in_a_row
from symsimpson.targets.counting import Cost, cost

HEAD = ("a step, general > here", "unknowns", "operations an iteration", "at its end")


@dataclass(frozen=True)
class StepCosts:
    """Unknowns and operations of a step, without and with what was found about a system.

    Attributes
    ----------
    general, here : dict
        Cost of a step by scheme, without and with what was found about the system: ``unknowns``,
        operations of an ``iteration`` and of ``closing`` the step.
    """

    general: dict[str, Cost]
    here: dict[str, Cost]

    def __repr__(self) -> str:
        table = [HEAD, *self._rows()]
        widths = [max(len(row[k]) for row in table) for k in range(len(HEAD))]
        return "\n".join(
            "  ".join(f"{cell:<{width}}" for cell, width in zip(row, widths, strict=True)).rstrip()
            for row in table
        )

    def _repr_html_(self) -> str:
        return markup.table([HEAD, *self._rows()])

    def _rows(self) -> list[tuple[str, ...]]:
        parts = ("unknowns", "iteration", "closing")
        return [
            (name, *(f"{getattr(general, x)} > {getattr(self.here[name], x)}" for x in parts))
            for name, general in self.general.items()
        ]


def step_costs(
    system: MechanicalSystem, schemes: str | Iterable[str] = ("simpson", "midpoint")
) -> StepCosts:
    """Generate modules with and without the findings of a system, and count what a step does.

    It takes seconds for small systems, and longer for large ones.

    Parameters
    ----------
    system : MechanicalSystem
    schemes : str or iterable of str

    Returns
    -------
    StepCosts

    Examples
    --------
    >>> import symsimpson as ss
    >>> ss.step_costs(ss.systems.kepler(), ["simpson"]).here["simpson"].unknowns
    2
    """
    check_system(system)
    names = in_a_row(schemes)
    return StepCosts(
        {name: cost(source(system, name, ())) for name in names},
        {name: cost(source(system, name)) for name in names},
    )
