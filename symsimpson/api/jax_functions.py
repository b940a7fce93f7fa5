"""Functions of runs for JAX, by callbacks with derivatives of their own."""

from __future__ import annotations

from collections.abc import Callable
from math import prod
from typing import Any

from symsimpson.api.host_functions import HostFunctions, Shapes
from symsimpson.errors import reject
from symsimpson.support.extras import import_library


def import_jax(use: str) -> Any:
    """Import JAX; raise InputError if it is not installed or does not use 64 bits."""
    jax = import_library("jax", use, "jax")
    if not jax.config.jax_enable_x64:
        reject(
            f"{use} needs numbers of 64 bits, which JAX does not use.",
            remedy="Call jax.config.update('jax_enable_x64', True) before you use JAX.",
        )
    return jax


def to_jax(host: HostFunctions, pack: Callable[[Any], Any], mode: str) -> Callable[..., Any]:
    """Return a function of JAX. ``pack`` converts the list of outputs."""
    if mode not in ("reverse", "forward"):
        reject(f"mode is {mode!r}.", remedy="Pass 'reverse' or 'forward'.")
    jax = import_jax("to_jax()")
    jnp = jax.numpy

    def call(function: Callable[..., Any], results: Shapes, *given: Any) -> list[Any]:
        """Call a function of the host; ``vmap`` adds first axes to all arrays."""
        first = given[0].shape[: given[0].ndim - len(host.arguments[0])]
        shapes = [jax.ShapeDtypeStruct((*first, *x), jnp.float64) for x in results]
        computed: list[Any] = jax.pure_callback(
            function, shapes, *given, vmap_method="broadcast_all"
        )
        return computed

    def values(*given: Any) -> list[Any]:
        return call(host.values, host.outputs, *given)

    if mode == "forward":
        run = jax.custom_jvp(values)

        @run.defjvp  # type: ignore[untyped-decorator]
        def differentiate(given: Any, directions: Any) -> tuple[list[Any], list[Any]]:
            blocks = iter(call(host.jacobian, host.blocks, *given))
            changes = []
            for output in host.outputs:
                parts = []
                for argument, along in zip(host.arguments, directions, strict=True):
                    first = along.shape[: along.ndim - len(argument)]
                    matrix = next(blocks).reshape((*first, -1, prod(argument)))
                    parts.append(matrix @ along.reshape((*first, -1, 1)))
                total = sum(parts)
                changes.append(total.reshape((*total.shape[:-2], *output)))
            return run(*given), changes

    else:
        run = jax.custom_vjp(values)
        pull = jax.custom_vjp(lambda *given: tuple(call(host.pull, host.arguments, *given)))
        both = (*host.arguments, *host.outputs)

        def keep(function: Any) -> Callable[..., tuple[Any, Any]]:
            return lambda *given: (function(*given), given)

        run.defvjp(keep(run), lambda given, weights: pull(*given, *weights))
        pull.defvjp(
            keep(pull), lambda given, along: tuple(call(host.pull_and_push, both, *given, *along))
        )

    def function(*arguments: Any) -> Any:
        import_jax("this function")
        if any(jnp.iscomplexobj(x) for x in arguments):
            reject("an argument is complex.", remedy="Pass real numbers.")
        given = [jnp.asarray(x, jnp.float64) for x in arguments]
        first = host.first_axes(given)
        given = [
            jnp.broadcast_to(x, (*first, *shape))
            for x, shape in zip(given, host.arguments, strict=True)
        ]
        return pack(run(*given))

    return function
