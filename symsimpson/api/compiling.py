"""The public functions that make steppers: ``compile``, ``generate``, ``load`` and ``resume``."""

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
from symsimpson.declare.prescribed import prescribed_values
from symsimpson.declare.retimed import RetimedSystem, extend_by_energy
from symsimpson.declare.system import MechanicalSystem
from symsimpson.discrete.equations import check_differentiable
from symsimpson.discrete.reductions import read_exploit
from symsimpson.errors import GenerationError, StorageError, reject
from symsimpson.lower.emitted_names import NameTable
from symsimpson.lower.pipeline import derive
from symsimpson.program.cache import load_or_derive
from symsimpson.program.numbers import Numbers
from symsimpson.program.program import Program, Tools, new_program, read_program
from symsimpson.results.trajectory import Trajectory
from symsimpson.run.checkpoint import read_description
from symsimpson.schemes.named import read_scheme
from symsimpson.schemes.scheme import Scheme
from symsimpson.support.calling import explain_arguments
from symsimpson.support.contact_values import reject_contacts
from symsimpson.support.derivation import Derivation
from symsimpson.support.files import atomic_path, read_path
from symsimpson.support.names import as_tuple, spelled
from symsimpson.support.progress import announce
from symsimpson.text.header import check_interface
from symsimpson.text.interface import INTERFACE

if TYPE_CHECKING:
    from symsimpson.stepping.event import Event


def _call(module: str, name: str, *arguments: Any, **options: Any) -> Any:
    """Call a function of ``study``, and import its module at the first call."""
    return getattr(import_module(f"symsimpson.study.{module}"), name)(*arguments, **options)


LOG = logging.getLogger(__name__)
#: Functions that need T and V, which rooms below ``api`` cannot import.
TOOLS = Tools(
    certify=partial(_call, "analysis.certify", "certify"),
    check_step=partial(_call, "analysis.stability.frequency", "warn_of_step"),
    force_terms=partial(_call, "analysis.stability.cancelling", "force_terms"),
    changes_of_potential=partial(_call, "analysis.stability.cancelling", "changes_of_potential"),
    at_pole=partial(_call, "analysis.stability.passages", "at_pole"),
    unresolved_pole=partial(_call, "analysis.stability.passages", "unresolved_pole"),
    unresolved_step=partial(_call, "analysis.stability.passages", "unresolved_step"),
    kink_passed=partial(_call, "analysis.stability.kinks", "kink_passed"),
    regular_box=partial(_call, "analysis.stability.passages", "regular_box"),
    points_of=points_of,
    prescribed=prescribed_values,
    find_orbits=partial(_call, "orbits.stepper_searches"),
    second_derivatives=partial(_call, "second_derivatives", "second_derivatives"),
)


@explain_arguments()
def compile(
    system: MechanicalSystem,
    scheme: str | Scheme = "simpson",
    *,
    exploit: str | Iterable[str] = "all",
    precision: int | None = None,
    arithmetic: Literal["mpmath", "arb"] = "mpmath",
    progress: bool | None = None,
) -> Stepper:
    """Derive and compile the variational integrator of a system.

    Parameters
    ----------
    system : MechanicalSystem
        The system: its kinetic and potential energy, forces and constraints.
    scheme : str or Scheme, default "simpson"
        ``"simpson"``, ``"midpoint"``, ``"lobatto6"``, ``"gauss4"``, ..., or a scheme from
        :func:`symsimpson.galerkin`.
    exploit : str or iterable of str, default "all"
        Structure that the generator may exploit: "decoupled", "cyclic", "constant_mass", "linear",
        "sparse" (see :attr:`MechanicalSystem.structure`). The trajectory stays the same up to
        round-off. ``()`` solves the general equations, for comparison. See Notes for "conformal".
    precision : int, optional
        Number of decimal digits. The module then runs in Python, the states are mpmath numbers,
        and Newton's method converges to all digits. You can pass numbers as strings (``"0.1"``),
        as SymPy numbers or as mpmath numbers. A float keeps its exact binary value. By default,
        the stepper computes in double precision.
    arithmetic : {"mpmath", "arb"}, default "mpmath"
        Multiprecision library. "arb" is python-flint, which is many times faster.
    progress : bool, optional
        True shows progress messages (needs tqdm), False shows none. By default, they appear after
        a second, in a terminal or a notebook.

    Returns
    -------
    Stepper
        The integrator. Its first run compiles the machine code and caches it on disk.

    Raises
    ------
    SchemeError
        If the scheme is unknown.
    GenerationError
        If the equations cannot be written as code, or ``exploit`` contains an unknown name.
    InputError
        If ``precision`` or ``arithmetic`` is invalid.

    Notes
    -----
    ``exploit=("all", "conformal")`` treats damping f = -2 gamma p by weights that grow in time.
    This is another scheme: its steps are conformally symplectic, and areas of phase space shrink by
    exactly exp(-2 gamma t). By default, damping is a force, and areas shrink by this factor up to
    the order of the scheme. Conformal steps must resolve the damping: gamma h < 0.1. Other steps
    stay accurate if the damping is strong.

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
        reject_contacts(system.modes, system.name, "many digits")
        from symsimpson.program.digits import read_precision  # loads mpmath

        numbers = read_precision(precision, arithmetic)
    return Stepper(_compile_program(system, method, read_exploit(exploit), numbers, progress, None))


def _compile_program(
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
    """Derive and compile the program of a system.

    ``varied`` names the parameters and inputs to differentiate steps by, besides q and p. None
    means no derivatives. Programs with derivatives can also integrate a ``running`` cost and have
    ``second`` derivatives.
    """
    tools: Tools | None = TOOLS
    if isinstance(system, RetimedSystem) and varied is not None:
        check_differentiable(scheme)
        known = dict(zip(NameTable(system).parameters, system.parameters, strict=True))
        # the extended system has the time as a momentum
        system, varied = extend_by_energy(system, [known[name] for name in varied])
        tools = None  # checks apply to the system of the user, not to the extended one
    with announce(f"deriving {scheme.name} for {system.name}", progress):
        derivation = _derive(system, scheme, exploit, varied, running, second=second)
    return new_program(
        derivation.text,
        f"{system.name}__{scheme.name}",
        defaults={symbol.name: value for symbol, value in system.parameters.items()},
        numbers=numbers,
        reference_state=getattr(system, "reference_state", None),
        default_inputs=getattr(system, "default_inputs", None),
        declared=system,
        method=scheme,
        derivation=derivation,
        tools=tools,
        differentiate=partial(_compile_program, system, scheme, exploit, numbers, progress),
        compile_for=partial(_compile_mode, scheme, exploit, varied),
    )


def _compile_mode(
    scheme: Scheme,
    exploit: frozenset[str],
    varied: tuple[str, ...] | None,
    system: MechanicalSystem,
) -> Program:
    return _compile_program(system, scheme, exploit, None, False, varied)


@lru_cache(maxsize=64)  # steppers of one declaration share its derivation
def _derive(
    system: MechanicalSystem,
    scheme: Scheme,
    exploit: frozenset[str],
    varied: tuple[str, ...] | None,
    running: Any,
    *,
    second: bool,
) -> Derivation:
    """Derive a module, or read from disk what another process derived for the same system."""

    def derive_module() -> Derivation:
        derivation = derive(system, scheme, exploit, varied, running, second=second)
        seconds = sum(derivation.seconds.values())
        LOG.info("derived %s for %s in %.2f s", scheme.name, system.name, seconds)
        return derivation

    if system.retiming is not None or running is not None:
        return derive_module()
    energies: list[object] = []  # a large system has its digest only: SymPy would take too long
    if not system.too_large_for_sympy:
        energies = [system.kinetic, system.potential, system.gyroscopic]
        energies.append(getattr(system, "hamiltonian", None))
    wanted = sorted(exploit), varied, second
    parts: list[object] = [system.digest, *energies, astuple(scheme), *wanted]
    parts += [(symbol.name, value) for symbol, value in system.parameters.items()]
    return load_or_derive(map(str, parts), derive_module)


@announce("deriving")
@explain_arguments()
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
        The system: its kinetic and potential energy, forces and constraints.
    scheme : str or Scheme, default "simpson"
        Name of a scheme, or a scheme from :func:`symsimpson.galerkin`.
    directory : path, default "generated"
        Folder of the file. `generate` creates it if necessary.
    exploit : str or iterable of str, default "all"
        Structure that the generator may exploit, as for :func:`compile`.
    derivatives : iterable of str, optional
        Names of parameters and inputs by which the module can differentiate its steps. ``()``
        gives derivatives by positions and momenta only. By default, the module has no derivatives.

    Returns
    -------
    pathlib.Path
        The path of the file. Its content is reproducible byte for byte. `generate` does not
        rewrite an identical file.

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
    reject_contacts(system.modes, system.name, "a generated file", GenerationError)
    method = read_scheme(scheme)
    path = read_path("directory", directory) / f"{system.name}__{method.name}.py"
    if derivatives is not None and isinstance(system, RetimedSystem):
        reject(
            "a module with derivatives cannot be written for a system with a time transformation.",
            where=f"system {system.name!r}",
            why="Its derivatives need more than one module.",
            remedy="Make a stepper with symsimpson.compile; its runs take tangents= and "
            "sensitivities=.",
            error=GenerationError,
        )
    names = None if derivatives is None else map(spelled, as_tuple(derivatives))
    content = derive(system, method, exploit, names).text.encode()
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        if not path.is_file() or path.read_bytes() != content:
            with atomic_path(path, "generated module") as whole:
                whole.write_bytes(content)
    except StorageError as error:
        reject(str(error), error=GenerationError, cause=error)
    except OSError as error:
        reject(
            f"the generated module cannot be written: {error.strerror}.",
            where=str(path),
            remedy="Choose another directory.",
            error=GenerationError,
            cause=error,
        )
    return path


@explain_arguments()
def load(path: str | os.PathLike[str]) -> Stepper:
    """Make a stepper from a generated file.

    `load` checks the digest and the structure of the file and then executes it. Load only files
    that you trust.

    Parameters
    ----------
    path : path
        A file that :func:`generate` wrote.

    Returns
    -------
    Stepper
        The stepper of the module in the file.

    Raises
    ------
    StaleKernelError
        If the file has another kernel interface, was edited, or is not a generated module.
    GenerationError
        If the file cannot be read.

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
            f"the file cannot be read: {error}.",
            where=os.fspath(path),
            remedy="Generate it with symsimpson.generate(system, scheme). Open a saved run with "
            "symsimpson.open_trajectory.",
            error=GenerationError,
            cause=error,
        )
    program = read_program(text, os.fspath(path), TOOLS)
    check_interface(program.header.layout, program.where, (INTERFACE,))
    return Stepper(program)


@explain_arguments()
def resume(
    path: str | os.PathLike[str],
    *,
    inputs: Any = None,
    events: Sequence[Event] | None = None,
    checkpoint_every: int | None = None,
    progress: bool | None = None,
    on_failure: Literal["raise", "return"] = "raise",
) -> Trajectory:
    """Resume an interrupted run from its checkpoint.

    The result is bitwise identical to that of a run without interruption. `resume` checks the
    digest and the structure of the module in the file and then executes it. Resume only files that
    you trust.

    Parameters
    ----------
    path : path
        The file that ``integrate(..., checkpoint=path)`` wrote.
    inputs : mapping, optional
        The inputs of the run, if the system has inputs. A checkpoint stores only their digest.
    events : sequence of Event, optional
        The events of the run, if it had any. A checkpoint stores their expressions and records.
    checkpoint_every, progress, on_failure
        The same arguments as for :meth:`Stepper.integrate`.

    Returns
    -------
    Trajectory
        The whole run, from its initial state.

    Raises
    ------
    StorageError
        If the file is not a complete checkpoint.
    StaleKernelError
        If the module in the file has another kernel interface.
    ConvergenceError
        If a step fails.
    Interrupted
        If you press Ctrl-C.

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
    request = read_description(read_path("the checkpoint", path))
    if "modes" in request:
        reject(
            "a checkpoint of a run with contacts or dry friction cannot be resumed alone.",
            where=os.fspath(path),
            why="It has the module of the motion without contacts only.",
            remedy="Repeat the call that started the run: integrate(..., checkpoint=...).",
        )
    program = read_program(request["source"], os.fspath(path), TOOLS, request.get("names"))
    stepper = Stepper(program)
    values = dict(zip(stepper.parameters, request["parameters"], strict=True))
    from_start = stepper.program.header.from_start
    parameters = {name: value for name, value in values.items() if name not in from_start}
    end = {"t_end": request["t_end"]} if "t_end" in request else {"steps": request["steps"]}
    return stepper.integrate(
        request["q0"],
        p0=request["p0"],
        h=request["h"],
        **end,
        t0=request["t0"],
        parameters=parameters,
        inputs=inputs,
        every=request["every"] or None,
        tangents=request.get("tangents"),
        sensitivities=stepper.program.header.varied_by if "tangents" in request else None,
        record=request.get("record"),
        reduce={name: (kind, text) for name, kind, text in request.get("reduce", ())} or None,
        events=events,
        checkpoint=path,
        checkpoint_every=checkpoint_every,
        progress=progress,
        on_failure=on_failure,
    )


def check_system(system: object) -> None:
    """Raise GenerationError unless the argument is a MechanicalSystem."""
    if not isinstance(system, MechanicalSystem):
        from symsimpson.systems import EVERY  # imported here, because only the message needs it

        what, name = type(system).__name__, getattr(system, "__name__", system)
        if isinstance(name, str) and name in EVERY and system in (name, EVERY[name]):
            reject(
                f"{name} is the {'name of a' if system == name else 'function that makes the'} "
                "system, not a MechanicalSystem.",
                remedy=f"Call it: symsimpson.systems.{name}().",
                error=GenerationError,
            )
        method = {"LagrangesMethod": "lagranges_method", "KanesMethod": "kanes_method"}.get(what)
        remedy = "Declare one: symsimpson.MechanicalSystem(name, coordinates=..., kinetic=...)."
        if method is not None:
            call = f"symsimpson.MechanicalSystem.from_{method}(name, method, parameters)"
            remedy = f"Convert it: {call}."
        reject(f"{what} is not a MechanicalSystem.", remedy=remedy, error=GenerationError)
