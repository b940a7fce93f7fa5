"""Conversion of functions of runs to JAX and PyTorch."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import Any, Literal

from symsimpson.api.host_functions import HostFunctions
from symsimpson.run.function_derivatives import FunctionDerivatives
from symsimpson.run.run_function import FunctionOfRun
from symsimpson.support.calling import explain_methods


@explain_methods()
class Convertible:
    """The part of :class:`RunFunction` that converts it to functions of other libraries."""

    def __init__(self, function: FunctionOfRun) -> None:
        self._function = function
        self._call, self._several = function.call, function.several_outputs
        self.arguments = tuple(argument.name for argument in function.arguments)
        self.outputs = tuple(output.name for output in function.outputs)

    @cached_property
    def _derivatives(self) -> FunctionDerivatives:
        return FunctionDerivatives(self._function)

    def _pack(self, outputs: Any) -> Any:
        """Return a tuple if the function has several outputs."""
        return tuple(outputs) if self._several else outputs[0]

    @property
    def _host(self) -> HostFunctions:
        return HostFunctions(self._function, self._derivatives)

    def to_jax(self, mode: Literal["reverse", "forward"] = "reverse") -> Callable[..., Any]:
        """Return the function for JAX. It works under ``jit``, ``vmap`` and ``grad``.

        Parameters
        ----------
        mode : {"reverse", "forward"}, default "reverse"
            "reverse" supports ``grad``, ``vjp`` and ``jacrev``, by the discrete adjoint, and second
            derivatives in reverse mode. "forward" computes the Jacobian, and supports ``jvp``,
            ``jacfwd`` and ``grad``. Use it if there are few arguments, and for runs without an
            adjoint.

        Returns
        -------
        callable
            A function with the same arguments. A ``vmap`` of it runs one ensemble.

        Raises
        ------
        InputError
            If JAX is not installed, or does not use 64 bits. A call raises it for a wrong shape.

        Examples
        --------
        >>> import jax, jax.numpy as jnp, symsimpson as ss
        >>> jax.config.update("jax_enable_x64", True)
        >>> f = ss.compile(ss.systems.pendulum()).function(h=0.01, steps=100, of="q")
        >>> swing = f.to_jax()
        >>> jax.grad(lambda q: swing(q, jnp.zeros(1))[0])(jnp.ones(1)).round(3)
        Array([-0.906], dtype=float64)
        """
        from symsimpson.api.jax_functions import to_jax

        return to_jax(self._host, self._pack, mode)

    def to_torch(self) -> Callable[..., Any]:
        """Return the function for PyTorch, with first and second derivatives.

        Returns
        -------
        callable
            A function of tensors on the CPU. Its results are tensors of float64. Second derivatives
            exist where :meth:`hvp` does.

        Raises
        ------
        InputError
            If PyTorch is not installed. A call raises it for a tensor on another device, and for a
            wrong shape.

        Examples
        --------
        >>> import torch, symsimpson as ss
        >>> f = ss.compile(ss.systems.pendulum()).function(h=0.01, steps=100, of="q")
        >>> swing, q = f.to_torch(), torch.ones(1, dtype=torch.float64, requires_grad=True)
        >>> swing(q, torch.zeros(1)).sum().backward()
        >>> q.grad.numpy().round(3)
        array([-0.906])
        """
        from symsimpson.api.torch_functions import to_torch

        return to_torch(self._host, self._pack)
