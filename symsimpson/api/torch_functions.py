"""Functions of runs for PyTorch, with first and second derivatives."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from symsimpson.api.host_functions import HostFunctions
from symsimpson.errors import reject
from symsimpson.support.extras import import_library


def to_torch(host: HostFunctions, pack: Callable[[Any], Any]) -> Callable[..., Any]:
    """Return a function of tensors. ``pack`` converts the tuple of outputs."""
    torch = import_library("torch", "to_torch()", "torch")

    def call(function: Callable[..., Any], *given: Any) -> tuple[Any, ...]:
        """Call a function of the host with the numbers of tensors."""
        computed = function(*(x.detach().numpy() for x in given))
        return tuple(torch.from_numpy(x.copy()) for x in computed)

    def make(evaluate: Callable[..., Any], pull: Callable[..., Any]) -> Any:
        """Return a function with a derivative: ``pull`` takes its arguments and weights."""

        class OfRun(torch.autograd.Function):  # type: ignore[name-defined]
            @staticmethod
            def forward(*given: Any) -> Any:
                return call(evaluate, *given)

            @staticmethod
            def setup_context(ctx: Any, inputs: Any, output: Any) -> None:
                ctx.save_for_backward(*inputs)

            @staticmethod
            def backward(ctx: Any, *weights: Any) -> Any:
                return pull(*ctx.saved_tensors, *weights)

            @staticmethod
            def vmap(info: Any, in_dims: Any, *given: Any) -> Any:
                rows = [
                    x.expand((info.batch_size, *x.shape)) if dim is None else x.movedim(dim, 0)
                    for x, dim in zip(given, in_dims, strict=True)
                ]
                computed = OfRun.apply(*rows)
                return computed, (0,) * len(computed)

        return OfRun.apply

    def no_more(*given: Any) -> Any:
        reject(
            "third derivatives of a run are not available.", remedy="Differentiate at most twice."
        )

    second = make(host.pull_and_push, no_more)
    run = make(host.values, make(host.pull, second))

    def function(*arguments: Any) -> Any:
        given = [
            x if isinstance(x, torch.Tensor) else torch.as_tensor(x, dtype=torch.float64)
            for x in arguments
        ]
        for x in given:
            if x.device.type != "cpu":
                reject(
                    f"a tensor is on the device {x.device}, but runs need the CPU.",
                    remedy="Pass tensor.cpu().",
                )
            if x.is_complex():
                reject("a tensor is complex.", remedy="Pass real numbers.")
        first = host.first_axes(given)
        given = [
            x.to(torch.float64).expand((*first, *shape))
            for x, shape in zip(given, host.arguments, strict=True)
        ]
        return pack(run(*given))

    return function
