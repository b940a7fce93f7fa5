"""Costs of a step: unknowns and operations, counted in generated modules."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from symsimpson.api.compiling import check_system
from symsimpson.declare.system import MechanicalSystem
from symsimpson.lower.pipeline import source
from symsimpson.support import markup
from symsimpson.support.names import as_tuple
from symsimpson.targets.counting import Cost, cost

HEAD = ("without > with reductions", "unknowns", "operations per iteration", "to close the step")


@dataclass(frozen=True)
class StepCosts:
    """Unknowns and operations of a step, without and with the reductions of a system.

    :func:`symsimpson.step_costs` returns it. The table that it prints has a row for each scheme,
    with the numbers without > with reductions.

    Attributes
    ----------
    general : dict
        The cost of a step without reductions, by the name of the scheme. A cost has the number of
        ``unknowns``, and the numbers of operations of an ``iteration`` and of ``closing`` the step.
    here : dict
        The cost of a step with all reductions of the system, by the name of the scheme.

    Examples
    --------
    >>> import symsimpson as ss
    >>> costs = ss.step_costs(ss.systems.kepler(), "simpson")
    >>> costs.general["simpson"].unknowns, costs.here["simpson"].unknowns
    (4, 2)
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
        """Return the cells of the table, a row for each scheme."""
        parts = ("unknowns", "iteration", "closing")
        return [
            (name, *(f"{getattr(general, x)} > {getattr(self.here[name], x)}" for x in parts))
            for name, general in self.general.items()
        ]


def step_costs(
    system: MechanicalSystem, schemes: str | Iterable[str] = ("simpson", "midpoint")
) -> StepCosts:
    """Count the unknowns and operations of a step, with and without the reductions of a system.

    Counting generates two modules for each scheme. This takes seconds for small systems, and
    longer for large ones.

    Parameters
    ----------
    system : MechanicalSystem
        The system.
    schemes : str or iterable of str, default ("simpson", "midpoint")
        The names of the schemes.

    Returns
    -------
    StepCosts
        The counts by scheme.

    Examples
    --------
    >>> import symsimpson as ss
    >>> ss.step_costs(ss.systems.kepler(), ["simpson"]).here["simpson"].unknowns
    2
    """
    check_system(system)
    names = as_tuple(schemes)
    return StepCosts(
        {name: cost(source(system, name, ())) for name in names},
        {name: cost(source(system, name)) for name in names},
    )
