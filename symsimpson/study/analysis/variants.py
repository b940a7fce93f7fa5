"""Steppers whose modules differ from generated ones: for comparison, never for use."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from symsimpson.api.stepper import Stepper
from symsimpson.program.program import new_program
from symsimpson.text.header import signed_anew, with_facts
from symsimpson.text.syntax import definitions, redefined


def rewritten(stepper: Stepper, constants: Mapping[str, str]) -> Stepper:
    """Return a stepper with other constants in its module, which is signed anew.

    ``constants`` are Python expressions by name. Raises ValueError if the module has no such
    constant.
    """
    missing = constants.keys() - definitions(stepper.source)
    if missing:
        raise ValueError(f"the module has no {', '.join(sorted(missing))}")
    changes = {name: f"{name} = {x}" for name, x in constants.items()}
    return _with(stepper, stepper.source, changes)


def _with(stepper: Stepper, text: str, changes: Mapping[str, str]) -> Stepper:
    """Return a stepper of a text with other definitions, which is signed anew."""
    program = new_program(
        signed_anew(redefined(text, changes)),
        f"{stepper.system}, changed",
        reference_state=stepper.reference_state,
        tools=stepper.program.tools,
        names=stepper.program.names,
    )
    return Stepper(program)


def in_tau(stepper: Stepper, values: Iterable[float] | None = None) -> Stepper:
    """Return a stepper that knows a retimed system by the time tau of its steps alone.

    Its energy is K = g (H - E0), and E0 and the rate dt/dtau of the start are parameters;
    ``values`` are the defaults of all. A stepper that is not retimed is returned as it is.
    """
    if not stepper.program.header.retimed:
        return stepper
    lines = stepper.source.splitlines(keepends=True)
    first, end = definitions(stepper.source)["energy_in_tau"]
    energy = "".join(lines[first:end]).replace("def energy_in_tau(", "def energy(").rstrip("\n")
    facts: dict[str, object] = {"retimed": False}
    if values is not None:
        facts["defaults"] = tuple(map(float, values))
    text = with_facts(stepper.source, facts)
    return _with(stepper, text, {"energy_in_tau": "", "energy": energy})


def oversolved(stepper: Stepper) -> Stepper:
    """Return a stepper whose iterations go on until corrections stagnate in rounding."""
    if stepper.program.header.newton_unknowns == 0:
        return stepper
    names = ("LOST", "ROUNDING") if stepper.program.header.by_stages else ("NEGLIGIBLE",)
    return rewritten(stepper, dict.fromkeys(names, "0.0"))
