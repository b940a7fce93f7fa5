"""Where an energy has a real value."""

from __future__ import annotations

from symsimpson.mechanics.plain import Plain

__all__ = ["has_real_energy"]


def has_real_energy(plain: Plain) -> bool:
    """Return whether the energy is real at all states, so that nobody need look.

    True is certain; where the sign of what a root or a logarithm is taken of is not known, the
    answer is False.
    """
    return plain.signs.real_everywhere(n for _, n in plain.energies)
