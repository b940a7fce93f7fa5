"""Search of a scheme by its name."""

from __future__ import annotations

import re

from symsimpson.errors import SchemeError, reject
from symsimpson.schemes.composition import COMPOSITIONS, composition
from symsimpson.schemes.scheme import MIDPOINT, SIMPSON, Scheme, galerkin
from symsimpson.support.names import did_you_mean

#: Names of schemes in other packages, with the names here.
ELSEWHERE = {
    **dict.fromkeys(("verlet", "stormer_verlet", "velocity_verlet", "leapfrog"), "lobatto2"),
    **dict.fromkeys(("trapezoid", "trapezoidal"), "lobatto2"),
    **dict.fromkeys(("implicit_midpoint", "imr"), "midpoint"),
}
#: Second names of schemes: Lobatto IIIA-IIIB methods with their orders.
SAME = {"lobatto_iiiab4": "lobatto_3_3", "lobatto_iiiab6": "lobatto_4_4"}


def read_scheme(scheme: str | Scheme) -> Scheme:
    """Return the scheme of this name, or the scheme itself."""
    if isinstance(scheme, Scheme):
        return scheme
    named = {s.name: s for s in (MIDPOINT, SIMPSON)}
    if isinstance(scheme, str):
        scheme = SAME.get(scheme, scheme)
        if scheme in named:
            return named[scheme]
        if scheme in COMPOSITIONS:
            return composition(scheme)
        if parts := re.fullmatch(r"(gauss|lobatto)([1-9][0-9]?)", scheme):
            kind, order = parts[1], int(parts[2])
            if order % 2 == 0:
                nodes = order // 2 + (kind == "lobatto")
                return galerkin(kind, nodes, nodes - (kind == "lobatto"))
        if parts := re.fullmatch(r"radau([1-9][0-9]?)", scheme):
            order = int(parts[1])
            if order % 2 == 1:
                return galerkin("radau", (order + 1) // 2, (order + 1) // 2)
        if parts := re.fullmatch(r"(gauss|lobatto|radau)_([1-9][0-9]?)_([1-9][0-9]?)", scheme):
            return galerkin(parts[1], int(parts[2]), int(parts[3]))
    family = ["gauss4", "gauss6", "gauss8", "lobatto6", "lobatto8", "radau3", "radau5"]
    known = [*named, *COMPOSITIONS, *family]
    hint = ""
    if isinstance(scheme, str):
        here = ELSEWHERE.get(scheme.lower())
        hint = f" Its name here is {here!r}." if here else did_you_mean(scheme, known)
    reject(
        f"there is no scheme {scheme!r}.{hint}",
        remedy="Choose 'midpoint', 'simpson', a Gauss or Lobatto scheme of even order ('gauss4', "
        "'lobatto6') or an explicit scheme ('kahan_li8', see symsimpson.composition). Or make a "
        "scheme with symsimpson.galerkin.",
        error=SchemeError,
    )
