"""The public functions that join the symbolic half to the compiled one."""

from __future__ import annotations

import logging
import os
from collections.abc import Iterable, Sequence
from dataclasses import astuple
from functools import lru_cache, partial
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from symsimpson.api.stepper import Stepper
from symsimpson.declare.declared import points_of
from symsimpson.declare.retimed import RetimedSystem, extended
from symsimpson.declare.system import MechanicalSystem
from symsimpson.discrete.equations import check_differentiable
from symsimpson.discrete.reductions import read_exploit
from symsimpson.errors import GenerationError, StorageError, reject
from symsimpson.lower.emitted_names import NameTable
from symsimpson.lower.pipeline import derive
from symsimpson.program.cache import kept_text
from symsimpson.program.numbers import Numbers
from symsimpson.program.program import Program, Tools, new_program, read_program
from symsimpson.results.trajectory import Trajectory
from symsimpson.run.checkpoint import read_asked
from symsimpson.schemes.named import read_scheme
from symsimpson.schemes.scheme import Scheme
from symsimpson.support.calling import explained
from symsimpson.support.derivation import Derivation
from symsimpson.support.files import read_path, written_beside
from symsimpson.support.names import in_a_row, spelled
from symsimpson.support.progress import waiting
from symsimpson.text.header import check_interface
from symsimpson.text.interface import INTERFACE

if TYPE_CHECKING:
    from symsimpson.stepping.event import Event


def _call(module: str, name: str, *given: Any, **named: Any) -> Any:
    """Call a function of the analysis, whose module is loaded by the first call."""
    return getattr(import_module(f"symsimpson.study.analysis.{module}"), name)(*given, **named)


LOG = logging.getLogger(__name__)
#: What steppers are given of the layers above them.
TOOLS = Tools(
    certify=partial(_call, "certify", "certify"),
    check_step=partial(_call, "stability.frequency", "warn_of_step"),
    force_terms=partial(_call, "stability.cancelling", "force_terms"),
    changes_of_potential=partial(_call, "stability.cancelling", "changes_of_potential"),
    at_pole=partial(_call, "stability.passages", "at_pole"),
    unresolved_pole=partial(_call, "stability.passages", "unresolved_pole"),
    unresolved_step=partial(_call, "stability.passages", "unresolved_step"),
    kink_passed=partial(_call, "stability.kinks", "kink_passed"),
    regular_box=partial(_call, "stability.passages", "regular_box"),
    points_of=points_of,
)


@explained()
def compile(
    system: MechanicalSystem,
    scheme: str | Scheme = "simpson",
    *,
    exploit: str | Iterable[str] = "all",
    precision: int | None = None,
    arithmetic: Literal["mpmath", "arb"] = "mpmath",
    progress: bool | None = None,
) -> Stepper:
    """Derive, emit and compile the integrator of a system.

    Parameters
    ----------
    system : MechanicalSystem
    scheme : str or Scheme
        ``"simpson"``, ``"midpoint"``, ``"lobatto6"``, ``"gauss4"``, ..., or a scheme made with
        :func:`symsimpson.galerkin`.
    exploit : "all" or iterable of str
        Structure that the generator may exploit: "decoupled", "cyclic", "constant_mass", "linear",
        "sparse" (see :attr:`MechanicalSystem.structure`). The trajectory is the same up to
        rounding; ``()`` keeps the general path, for comparison. ``("all", "conformal")`` treats
        damping f = -2 gamma p by weights that grow in time, which is another scheme: the step is
        conformally symplectic, and areas of phase space shrink by exactly exp(-2 gamma t). As a
        force, damping does this to the order of the scheme. Such steps must resolve the damping,
        gamma h < 0.1; others stay accurate where it is strong.
    precision : int, optional
        Decimal digits. The same module then runs in Python, states are numbers of mpmath, and
        Newton's method goes on to all digits. Numbers can be given as strings (``"0.1"``), as
        SymPy numbers or as numbers of mpmath; a float stands for the binary number that it is.
    arithmetic : {"mpmath", "arb"}
        What computes with many digits; "arb" is python-flint, many times as fast.
    progress : bool, optional
        Whether to tell what is waited for (needs tqdm); None tells after a second, in a
        terminal or a notebook.

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
    InputError
        If there is no such precision.

    Examples
    --------
    >>> import symsimpson as ss
    >>> ss.compile(ss.systems.pendulum(), "midpoint")
    Stepper(pendulum, midpoint, order 2)
    >>> precise = ss.compile(ss.systems.pendulum(), precision=30)
    >>> print(precise.integrate(["0.1"], v0=[0], h="0.01", steps=1).q[1, 0])
    0.0999510356921338486240015870667
    """
    check_system(system)
    method = read_scheme(scheme)
    numbers = None
    if precision is not None or arithmetic != "mpmath":
        from symsimpson.program.digits import read_precision  # loads mpmath

        numbers = read_precision(precision, arithmetic)
    return Stepper(_compiled(system, method, read_exploit(exploit), numbers, progress, None))


def _compiled(
    system: MechanicalSystem,
    scheme: Scheme,
    exploit: frozenset[str],
    numbers: Numbers | None,
    progress: bool | None,
    varied: tuple[str, ...] | None,
    running: Any = None,
    *,
    second: bool = False,
) -> Program:
    """Make a program; its steps are differentiated if it is said by what, beside q and p.

    Then it can integrate a ``running`` cost, too, and differentiate rows a ``second`` time.
    """
    tools: Tools | None = TOOLS
    if isinstance(system, RetimedSystem) and varied is not None:
        check_differentiable(scheme)
        known = dict(zip(NameTable(system).parameters, system.parameters, strict=True))
        # the time is one of its momenta
        system, varied = extended(system, [known[name] for name in varied])
        tools = None  # the user's system is looked at
    with waiting(f"deriving {scheme.name} for {system.name}", progress):
        derivation = _derived(system, scheme, exploit, varied, running, second=second)
    return new_program(
        derivation.text,
        f"{system.name}__{scheme.name}",
        defaults={symbol.name: value for symbol, value in system.parameters.items()},
        numbers=numbers,
        reference_state=getattr(system, "reference_state", None),
        declared=system,
        derivation=derivation,
        tools=tools,
        differentiate=partial(_compiled, system, scheme, exploit, numbers, progress),
    )


@lru_cache(maxsize=64)  # steppers of one declaration read it once
def _derived(
    system: MechanicalSystem,
    scheme: Scheme,
    exploit: frozenset[str],
    varied: tuple[str, ...] | None,
    running: Any,
    *,
    second: bool,
) -> Derivation:
    """Derive a module, or take what another process has derived of the same declaration."""

    def derived() -> Derivation:
        derivation = derive(system, scheme, exploit, varied, running, second=second)
        seconds = sum(derivation.seconds.values())
        LOG.info("derived %s for %s in %.2f s", scheme.name, system.name, seconds)
        return derivation

    if system.retiming is not None or running is not None or system.too_large_for_sympy:
        return derived()
    energies = (system.kinetic, system.potential, system.gyroscopic)
    wanted = sorted(exploit), varied, second
    parts: list[object] = [system.digest, *energies, astuple(scheme), *wanted]
    parts += [(symbol.name, value) for symbol, value in system.parameters.items()]
    return kept_text(map(str, parts), derived)


@waiting("deriving")
@explained()
def generate(
    system: MechanicalSystem,
    scheme: str | Scheme = "simpson",
    directory: str | os.PathLike[str] = "generated",
    *,
    exploit: str | Iterable[str] = "all",
    derivatives: Iterable[str] | None = None,
) -> Path:
    """Write the module of a system and a scheme to ``<directory>/<name>__<scheme>.py``.

    Parameters
    ----------
    system : MechanicalSystem
    scheme : str or Scheme
    directory : path
        Made if need be.
    exploit : "all" or iterable of str
        As for :func:`compile`.
    derivatives : iterable of str, optional
        Names of parameters and inputs by which the module can differentiate its steps, beside
        positions and momenta; ``()`` for these alone. By default it has no derivatives.

    Returns
    -------
    pathlib.Path
        The file. Its content is reproducible to the byte; an identical file is not rewritten.

    Raises
    ------
    GenerationError
        If the file cannot be written.

    Examples
    --------
    >>> import tempfile, symsimpson as ss
    >>> ss.generate(ss.systems.pendulum(), "midpoint", tempfile.mkdtemp()).name
    'pendulum__midpoint.py'
    """
    check_system(system)
    method = read_scheme(scheme)
    path = read_path("directory", directory) / f"{system.name}__{method.name}.py"
    if derivatives is not None and isinstance(system, RetimedSystem):
        reject(
            f"{system.name} is retimed, and derivatives of its runs take more than one module.",
            remedy="Make a stepper with symsimpson.compile, whose runs carry tangents= "
            "and sensitivities=.",
            error=GenerationError,
        )
    names = None if derivatives is None else map(spelled, in_a_row(derivatives))
    content = derive(system, method, exploit, names).text.encode()
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        if not path.is_file() or path.read_bytes() != content:
            with written_beside(path, "generated module") as whole:
                whole.write_bytes(content)
    except StorageError as error:
        reject(str(error), error=GenerationError, cause=error)
    except OSError as error:
        reject(
            f"{path}: the generated module cannot be written: {error.strerror}.",
            remedy="Choose another directory.",
            error=GenerationError,
            cause=error,
        )
    return path


@explained()
def load(path: str | os.PathLike[str]) -> Stepper:
    """Make a stepper from a generated file.

    Parameters
    ----------
    path : path
        A file that :func:`generate` wrote. It is executed, after its digest and its structure
        were checked: load only files that you trust.

    Raises
    ------
    StaleKernelError
        If the file is of another kernel interface, was edited, or is no generated module.
    GenerationError
        If it cannot be read.

    Examples
    --------
    >>> import tempfile, symsimpson as ss
    >>> path = ss.generate(ss.systems.pendulum(), "midpoint", tempfile.mkdtemp())
    >>> ss.load(path)
    Stepper(pendulum, midpoint, order 2)
    """
    place = read_path("the generated file", path)
    try:
        text = place.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reject(
            f"{os.fspath(path)}: the file cannot be read: {error}.",
            remedy="Generate it with symsimpson.generate(system, scheme). A run that was "
            "saved is read by "
            "symsimpson.open_trajectory.",
            error=GenerationError,
            cause=error,
        )
    program = read_program(text, os.fspath(path), TOOLS)
    check_interface(program.header.layout, program.where, (INTERFACE,))
    return Stepper(program)


@explained()
def resume(
    path: str | os.PathLike[str],
    *,
    inputs: Any = None,
    events: Sequence[Event] | None = None,
    checkpoint_every: int | None = None,
    progress: bool | None = None,
    on_failure: Literal["raise", "return"] = "raise",
) -> Trajectory:
    """Resume a run from its checkpoint, with bitwise the same result as without interruption.

    Parameters
    ----------
    path : path
        The file that ``integrate(..., checkpoint=path)`` wrote. The module in it is executed,
        after its digest and its structure were checked: resume only files that you trust.
    inputs : mapping, optional
        Those of the run, if the system has any: a checkpoint keeps their digest alone.
    events : sequence of Event, optional
        Those of the run, if it had any: a checkpoint keeps what they did, and how they read.
    checkpoint_every, progress, on_failure
        As for :meth:`Stepper.integrate`.

    Returns
    -------
    Trajectory
        Of the whole run, from its beginning.

    Raises
    ------
    StorageError
        If there is no whole checkpoint.
    StaleKernelError
        If it is of another kernel interface.
    ConvergenceError, Interrupted
        As :meth:`Stepper.integrate`.

    Examples
    --------
    >>> import tempfile, symsimpson as ss
    >>> file = tempfile.mkdtemp() + "/run.ckpt"
    >>> stepper = ss.compile(ss.systems.pendulum())
    >>> run = stepper.integrate([1.0], v0=[0.0], h=0.05, t_end=10, checkpoint=file)
    >>> again = ss.resume(file)
    >>> bool((again.q == run.q).all())
    True
    """
    asked = read_asked(read_path("the checkpoint", path))
    program = read_program(asked["source"], os.fspath(path), TOOLS, asked.get("names"))
    stepper = Stepper(program)
    values = dict(zip(stepper.parameters, asked["parameters"], strict=True))
    from_start = stepper.program.header.from_start
    parameters = {name: value for name, value in values.items() if name not in from_start}
    end = {"t_end": asked["t_end"]} if "t_end" in asked else {"steps": asked["steps"]}
    return stepper.integrate(
        asked["q0"],
        p0=asked["p0"],
        h=asked["h"],
        **end,
        t0=asked["t0"],
        parameters=parameters,
        inputs=inputs,
        every=asked["every"] or None,
        tangents=asked.get("tangents"),
        sensitivities=stepper.program.header.varied_by if "tangents" in asked else None,
        record=asked.get("record"),
        reduce={name: (kind, text) for name, kind, text in asked.get("reduce", ())} or None,
        events=events,
        checkpoint=path,
        checkpoint_every=checkpoint_every,
        progress=progress,
        on_failure=on_failure,
    )


def check_system(system: object) -> None:
    """Refuse what is no system, in words; raises GenerationError."""
    if not isinstance(system, MechanicalSystem):
        from symsimpson.systems import EVERY  # only a message needs the catalogue

        what, name = type(system).__name__, getattr(system, "__name__", system)
        if isinstance(name, str) and name in EVERY and system in (name, EVERY[name]):
            reject(
                f"{name} is the {'name of a' if system == name else 'function that makes the'} "
                "system.",
                remedy=f"Call it: symsimpson.systems.{name}().",
                error=GenerationError,
            )
        method = {"LagrangesMethod": "lagranges_method", "KanesMethod": "kanes_method"}.get(what)
        how = "Declare one: symsimpson.MechanicalSystem(name, coordinates=..., kinetic=..., ...)."
        if method is not None:
            how = f"Read it: symsimpson.MechanicalSystem.from_{method}(name, method, parameters)."
        reject(f"{what} is not a MechanicalSystem.", remedy=f"{how}", error=GenerationError)
