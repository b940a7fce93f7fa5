"""Signs that values have wherever they are defined, and where they are defined."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from symsimpson.graph.nodes import Graph, Value

#: Functions that are positive everywhere, and those with the sign of their argument.
POSITIVE = frozenset(["exp", "cosh", "softplus"])
LIKE_ARGUMENT = frozenset(["sinh", "tanh", "asinh", "atan", "erf"])
#: Functions with a real value only on a part of the real numbers.
PARTIAL = frozenset(["asin", "acos", "acosh", "atanh"])


class Signs:
    """The signs of nodes, as far as they are known.

    Symbols are ``"positive"``, ``"nonnegative"``, ``"negative"`` or ``"nonpositive"``. A sign is a
    pair: the sign itself, 1, -1 or 0 for unknown, and whether zero is excluded.
    """

    def __init__(self, graph: Graph, known: Mapping[int, str]) -> None:
        self._graph = graph
        words = {
            "positive": (1, True),
            "nonnegative": (1, False),
            "negative": (-1, True),
            "nonpositive": (-1, False),
        }
        self._done: dict[int, tuple[int, bool]] = {n: words[word] for n, word in known.items()}

    def __call__(self, value: Value) -> tuple[int, bool]:
        """Return the sign of a value."""
        coefficient, n = value
        if not coefficient:
            return 1, False
        for m in self._graph.reached([n]) if n not in self._done else ():
            if m not in self._done:
                self._done[m] = self._node(m)
        sign, strict = self._done[n]
        return (sign if coefficient > 0 else -sign), strict

    def _node(self, n: int) -> tuple[int, bool]:
        kind, parts, _ = self._graph.nodes[n]
        match kind:
            case "unit" | "constant":
                return 1, True
            case "sum":
                signs = [self((c, m)) for c, m in parts]
                if len({s for s, _ in signs}) == 1:
                    return signs[0][0], any(strict for _, strict in signs)
            case "product":
                return self._product(parts)
            case "function":
                name, *arguments = parts
                if name in POSITIVE:
                    return 1, True
                sign, strict = self(arguments[0])
                if name in LIKE_ARGUMENT:
                    return sign, strict
                if name == "pow" and sign == 1:
                    return 1, strict
                if name == "atan2" and self(arguments[1]) == (1, True):
                    return sign, strict
        return 0, False

    def _product(self, parts: Iterable[tuple[int, object]]) -> tuple[int, bool]:
        sign, strict = 1, True
        for m, e in parts:
            factor_sign, definite = self._done[m]
            if e.denominator != 1 or e.numerator % 2 == 0:  # type: ignore[attr-defined]
                factor_sign = 1
            sign, strict = sign * factor_sign, strict and definite
        return sign, strict

    def real_everywhere(self, roots: Iterable[int]) -> bool:
        """Return whether nodes are real wherever they have a value; True is certain."""
        for n in self._graph.reached(roots):
            kind, parts, _ = self._graph.nodes[n]
            if kind == "product":
                if any(e.denominator != 1 and self((1, m))[0] != 1 for m, e in parts):
                    return False
            elif kind == "function" and (
                parts[0] in PARTIAL or (parts[0] in ("log", "pow") and self(parts[1])[0] != 1)
            ):
                return False
        return True

    def never_real(self, n: int) -> bool:
        """Return whether a node is a root or a logarithm of what is always negative."""
        kind, parts, _ = self._graph.nodes[n]
        if kind == "product":
            return any(e.denominator != 1 and self((1, m)) == (-1, True) for m, e in parts)
        return (
            kind == "function"
            and parts[0] in ("log", "pow")
            and self(parts[1]) == (-1, True)
            and not (parts[0] == "pow" and parts[2][1] == 0)
        )
