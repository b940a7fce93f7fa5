"""The public functions that join the symbolic half to the compiled one."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path

from symsimpson.codegen.pipeline import source
from symsimpson.errors import GenerationError
from symsimpson.mechanics.system import MechanicalSystem
from symsimpson.runtime.stepper import Stepper
from symsimpson.schemes.scheme import Scheme, read_scheme

__all__ = ["compile", "generate", "load"]


def compile(
    system: MechanicalSystem,
    scheme: str | Scheme = "simpson",
    *,
    exploit: str | Iterable[str] = "all",
) -> Stepper:
    """Derive, emit and compile the integrator of a system.

    Parameters
    ----------
    system : MechanicalSystem
    scheme : str or Scheme
        ``"simpson"``, ``"midpoint"``, ``"lobatto6"``, ``"gauss4"``, ..., or a scheme made with
        :func:`symsimpson.galerkin`.
    exploit : "all" or iterable of str
        What the generator may make use of: "decoupled", "cyclic", "constant_mass", "linear",
        "sparse" (see :attr:`MechanicalSystem.structure`). All of it gives the same trajectory up
        to rounding; ``()`` keeps the general path, for comparison.

    Returns
    -------
    Stepper
        Its machine code is made when first needed, and kept on disk for the next process.

    Raises
    ------
    SchemeError
        If there is no such scheme.
    GenerationError
        If the equations cannot be written as code, or ``exploit`` names something else.

    Examples
    --------
    >>> import symsimpson as ss
    >>> ss.compile(ss.systems.pendulum(), "midpoint")
    Stepper(pendulum, midpoint, order 2)
    """
    _check_system(system)
    found = read_scheme(scheme)
    defaults = {symbol.name: value for symbol, value in system.parameters.items()}
    return Stepper(
        source(system, found, exploit), f"{system.name}__{found.name}", defaults=defaults
    )


def generate(
    system: MechanicalSystem,
    scheme: str | Scheme = "simpson",
    directory: str | os.PathLike[str] = "generated",
) -> Path:
    """Write the module of a system and a scheme to ``<directory>/<name>__<scheme>.py``.

    Parameters
    ----------
    system : MechanicalSystem
    scheme : str or Scheme
    directory : path
        Made if need be.

    Returns
    -------
    pathlib.Path
        The file; it has the same bytes every time, and is left alone if it has them already.

    Raises
    ------
    GenerationError
        If the file cannot be written.
    """
    _check_system(system)
    found = read_scheme(scheme)
    path = Path(directory) / f"{system.name}__{found.name}.py"
    content = source(system, found).encode()
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        if not path.is_file() or path.read_bytes() != content:
            path.write_bytes(content)
    except OSError as error:
        raise GenerationError(
            f"{path}: the generated module cannot be written: {error.strerror}.\n"
            "Choose another directory."
        ) from error
    return path


def load(path: str | os.PathLike[str]) -> Stepper:
    """Make a stepper from a generated file.

    Parameters
    ----------
    path : path
        A file that :func:`generate` wrote. It is executed: load only files that you trust.

    Raises
    ------
    StaleKernelError
        If the file is of another kernel interface, was edited, or is no generated module.
    GenerationError
        If it cannot be read.
    """
    try:
        text = Path(path).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise GenerationError(
            f"{os.fspath(path)}: the file cannot be read: {error}.\n"
            "Generate it with symsimpson.generate(system, scheme)."
        ) from error
    return Stepper(text, os.fspath(path))


def _check_system(system: object) -> None:
    if not isinstance(system, MechanicalSystem):
        raise GenerationError(
            f"{type(system).__name__} is not a MechanicalSystem.\n"
            "Declare one: symsimpson.MechanicalSystem(name, coordinates=..., kinetic=..., ...)."
        )
