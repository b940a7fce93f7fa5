"""Functions of runs and their derivatives for other libraries: arrays with any first axes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import prod
from typing import Any

import numpy as np

from symsimpson.errors import reject
from symsimpson.run.function_derivatives import FunctionDerivatives
from symsimpson.run.run_function import FunctionOfRun
from symsimpson.support.array_types import Reals

Shapes = Sequence[tuple[int, ...]]


class HostFunctions:
    """The evaluation and derivatives of a function. All arrays of a call have equal first axes.

    Libraries add these axes when they vectorise a function. They become the members of one
    ensemble. ``arguments`` and ``outputs`` are the shapes of one member.
    """

    def __init__(self, function: FunctionOfRun, derivatives: FunctionDerivatives) -> None:
        self._function, self._derivatives = function, derivatives
        if not function.program.numbers.compiled:
            reject(
                "JAX and PyTorch need double precision, but this stepper has another precision.",
                remedy="Compile a stepper without precision=.",
            )
        self.arguments: Shapes = [argument.shape for argument in function.arguments]
        self.outputs: Shapes = function.output_shapes
        self.blocks: Shapes = [(*x, *y) for x in self.outputs for y in self.arguments]

    def values(self, *given: Any) -> list[Reals]:
        """Return the outputs."""
        return self._by_members(self._function.values, given, self.arguments, self.outputs)

    def jacobian(self, *given: Any) -> list[Reals]:
        """Return the derivatives of each output by each argument, in one list."""

        def differentiate(arguments: tuple[Any, ...]) -> Sequence[Reals]:
            return [x for row in self._derivatives.jacobian(arguments) for x in row]

        return self._by_members(differentiate, given, self.arguments, self.blocks)

    def pull(self, *given: Any) -> list[Reals]:
        """Return the derivatives by the arguments, from arguments and weights of the outputs."""
        m, shapes = len(self.arguments), (*self.arguments, *self.outputs)
        return self._by_members(
            lambda x: self._derivatives.pull_back(x[:m], x[m:])[1], given, shapes, self.arguments
        )

    def pull_and_push(self, *given: Any) -> list[Reals]:
        """Return what the derivative of :meth:`pull` needs, from its arguments and a direction.

        They are the product of the second derivatives with the direction, by argument, and the
        derivatives of the outputs along it.
        """
        m, k = len(self.arguments), len(self.outputs)

        def differentiate(x: tuple[Any, ...]) -> Sequence[Reals]:
            arguments, weights, direction = x[:m], x[m : m + k], x[m + k :]
            _, products = self._derivatives.curve(arguments, weights, direction)
            return [*products, *self._derivatives.push_forward(arguments, direction)]

        shapes = (*self.arguments, *self.outputs, *self.arguments)
        return self._by_members(differentiate, given, shapes, shapes[: m + k])

    def first_axes(self, given: Sequence[Any]) -> tuple[int, ...]:
        """Return the first axes of the arguments of a call, to which all are broadcast."""
        if len(given) != len(self.arguments):
            self._function.read(tuple(given))  # raises the error
        axes = []
        for argument, value in zip(self._function.arguments, given, strict=True):
            shape, axes_of_value = tuple(value.shape), len(argument.shape)
            if shape[len(shape) - axes_of_value :] != argument.shape or len(shape) < axes_of_value:
                reject(
                    f"argument {argument.name} has shape {shape}, but its last axes must be "
                    f"{argument.shape}.",
                    where=self._function.program.system,
                    remedy="Put the axes of members first.",
                )
            axes.append(shape[: len(shape) - axes_of_value])
        try:
            return np.broadcast_shapes(*axes)
        except ValueError:
            reject(
                f"the arguments have different first axes: {', '.join(map(str, axes))}.",
                remedy="Pass the same number of members in each argument.",
            )

    @staticmethod
    def _by_members(
        function: Callable[[tuple[Any, ...]], Sequence[Reals]],
        given: Sequence[Any],
        shapes: Shapes,
        results: Shapes,
    ) -> list[Reals]:
        """Call a function with all first axes joined to one, and separate them in its results."""
        arrays = [np.asarray(x) for x in given]
        first = arrays[0].shape[: arrays[0].ndim - len(shapes[0])]
        if first:
            pairs = zip(arrays, shapes, strict=True)
            arrays = [x.reshape((prod(first), *shape)) for x, shape in pairs]
        computed = function(tuple(arrays))
        return [
            np.asarray(x).reshape((*first, *shape))
            for x, shape in zip(computed, results, strict=True)
        ]
