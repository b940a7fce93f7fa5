"""Steppers with changed modules, for measurements only."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from symsimpson.api.stepper import Stepper
from symsimpson.program.program import new_program
from symsimpson.text.header import signed_anew, with_facts
from symsimpson.text.syntax import definitions, redefined


def redefine_constants(stepper: Stepper, constants: Mapping[str, str]) -> Stepper:
    """Return a stepper with other values of constants in its module.

    ``constants`` are Python expressions by name. Raises ValueError if the module has no constant
    with such a name.
    """
    missing = constants.keys() - definitions(stepper.source)
    if missing:
        raise ValueError(f"the module has no constants {', '.join(sorted(missing))}.")
    changes = {name: f"{name} = {x}" for name, x in constants.items()}
    return _change_source(stepper, stepper.source, changes)


def _change_source(stepper: Stepper, text: str, changes: Mapping[str, str]) -> Stepper:
    """Return a stepper of the source ``text`` with other definitions and a new digest."""
    program = new_program(
        signed_anew(redefined(text, changes)),
        f"{stepper.system}, changed",
        reference_state=stepper.reference_state,
        tools=stepper.program.tools,
        names=stepper.program.names,
    )
    return Stepper(program)


def in_tau(stepper: Stepper, values: Iterable[float] | None = None) -> Stepper:
    """Return a stepper of a time-transformed system with tau as its only time.

    Its energy is K = g (H - E0). E0 and the initial rate dt/dtau are parameters, and ``values`` are
    the defaults of all parameters. Without a time transformation, the same stepper is returned.
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
    return _change_source(stepper, text, {"energy_in_tau": "", "energy": energy})


def iterate_to_round_off(stepper: Stepper) -> Stepper:
    """Return a stepper that iterates until the corrections are round-off errors."""
    if stepper.program.header.newton_unknowns == 0:
        return stepper
    names = ("LOST", "ROUNDING") if stepper.program.header.by_stages else ("NEGLIGIBLE",)
    return redefine_constants(stepper, dict.fromkeys(names, "0.0"))
