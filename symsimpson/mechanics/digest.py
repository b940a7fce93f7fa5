"""Digests that tell one declaration from another."""

from __future__ import annotations

import hashlib
import json

import sympy as sp

from symsimpson.mechanics.declared import Declared

__all__ = ["fingerprint"]


def fingerprint(system: Declared) -> str:
    """Return the SHA-256 over names and equations of a system, not over its parameters' values."""
    plain = system.plain
    forces = [value for force in plain.forces.values() for value in force]
    values = [plain.T, *plain.energies, *plain.invariants.values(), *forces]
    values += plain.held_values
    nodes = plain.graph.reached(n for _, n in values)
    place = {n: k for k, n in enumerate(nodes)}

    def spelled(n: int) -> str:
        kind, parts, _ = plain.graph.nodes[n]
        match kind:
            case "sum":
                return str([(str(c), place[m]) for c, m in parts])
            case "product":
                return str([(place[m], str(e)) for m, e in parts])
            case "function":
                return str([parts[0], *((str(c), place[m]) for c, m in parts[1:])])
        return str(parts)

    content = [
        system.name,
        [str(q) for q in system.coordinates],
        [sp.srepr(a) for a in system.parameters],
        sorted(plain.M),
        [(plain.graph.nodes[n].kind, spelled(n)) for n in nodes],
        [(str(c), place[n]) for c, n in values],
        list(plain.invariants),
        *([list(plain.forces)] if plain.forces else []),
        *([list(map(str, system.inputs))] if system.inputs else []),
        *([["constraints", *plain.constraints]] if plain.constraints else []),
        *([["of velocities", *rolling]] if (rolling := plain.velocity_constraints) else []),
    ]
    return hashlib.sha256(json.dumps(content).encode()).hexdigest()
