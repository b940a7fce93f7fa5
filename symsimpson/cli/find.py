"""Systems, states and files that a command line names."""

from __future__ import annotations

import argparse
import contextlib
import importlib.util
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from symsimpson.errors import InputError, SymsimpsonError
from symsimpson.support.files import check_folder
from symsimpson.support.names import did_you_mean

if TYPE_CHECKING:
    from symsimpson.declare.system import MechanicalSystem


#: Kinds of files that figures go to.
FIGURES = (".png", ".pdf", ".svg")


def check_figure(option: str, path: str) -> None:
    """Refuse a figure's file that has an unknown format or no folder, before any computation.

    Raises InputError or StorageError.
    """
    if Path(path).suffix not in FIGURES:
        raise InputError(
            f"--{option} {path}: unknown format.\nUse a name in {', '.join(FIGURES[:-1])} or "
            f"{FIGURES[-1]}."
        )
    check_folder(Path(path), "figure")


def state_of(system: MechanicalSystem, options: argparse.Namespace) -> dict[str, Any]:
    """Return the state that is asked for, or the one that the catalogue names.

    Raises InputError if there is none.
    """
    given = {k: getattr(options, k) for k in ("q0", "v0", "p0")}
    asked = {k: x for k, x in given.items() if x is not None}
    state = asked or dict(getattr(system, "reference_state", {}))
    if "q0" not in state:
        what = f"{' and '.join(f'--{k}' for k in asked)} without --q0"
        what = what if asked else f"{system.name} has no reference state"
        raise InputError(f"{what}.\nPass --q0 and --v0 or --p0.")
    if ("v0" in state) == ("p0" in state):
        raise InputError("--q0 needs exactly one of --v0 and --p0.\nPass numbers, as --v0 0,0.")
    return state


def find(name: str, rate: str | None = None) -> MechanicalSystem:
    """Return a system of the catalogue or of file:attribute, retimed if a rate is given."""
    system = named(name)
    return system if rate is None else system.retimed(rate)


def named(name: str) -> MechanicalSystem:
    """Return a system of the catalogue or of file:attribute."""
    from symsimpson.declare.system import MechanicalSystem
    from symsimpson.systems import CATALOGUE, EVERY

    if name in EVERY:
        return EVERY[name]()
    for make in CATALOGUE.values():
        system = make()
        if system.name == name:
            return system
    path, separator, attribute = name.rpartition(":")
    if not separator:
        if name.endswith(".py") and Path(name).is_file():
            raise InputError(
                f"{name} is a file, of which this command needs a system.\nName the variable that "
                f"holds it: {name}:system. Generated modules are taken by symsimpson certify alone."
            )
        raise InputError(
            f"there is no system {name!r} in the catalogue.{did_you_mean(name, EVERY)}\n"
            "Run symsimpson list to see the catalogue. For your own system give "
            "path/to/file.py:attribute."
        )
    if not Path(path).is_file():
        raise InputError(f"there is no file {path}.\nGive path/to/file.py:attribute.")
    with _as_a_script(path):
        remedy = f"python {path} runs it by itself."
        with _of_the_user(f"{path}: the file cannot be run", remedy):
            spec = importlib.util.spec_from_file_location("symsimpson_user_file", path)
            if spec is None or spec.loader is None:
                raise ImportError("not a Python file")
            module = importlib.util.module_from_spec(spec)
            sys.modules[spec.name] = module  # dataclasses look there
            try:
                spec.loader.exec_module(module)
            except SystemExit as error:
                if error.code:  # neither None nor 0: the file says that it failed
                    raise
        candidate = getattr(module, attribute, None)
        if callable(candidate) and not isinstance(candidate, MechanicalSystem):
            called = "The function that makes a system is called without arguments."
            with _of_the_user(f"{path}: {attribute}() makes no system", called):
                candidate = candidate()
    if not isinstance(candidate, MechanicalSystem):
        raise InputError(
            f"{path}: {attribute!r} is no MechanicalSystem.\n"
            "Give the name of a variable that holds one, or of a function that makes one."
        )
    return candidate


@contextlib.contextmanager
def _as_a_script(path: str) -> Iterator[None]:
    """Let a file find its neighbours, and no arguments of the command, as ``python path`` does."""
    folder, before, arguments = Path(path).resolve().parent, {*sys.modules}, sys.argv
    sys.path.insert(0, str(folder))
    sys.argv = [path]
    try:
        yield
    finally:
        sys.argv = arguments
        with contextlib.suppress(ValueError):
            sys.path.remove(str(folder))
        for name in {*sys.modules} - before:  # another file may have a neighbour of that name
            if Path(getattr(sys.modules[name], "__file__", None) or "").parent == folder:
                del sys.modules[name]


@contextlib.contextmanager
def _of_the_user(what: str, remedy: str) -> Iterator[None]:
    """Tell what a user's own code raises, whatever it may be, in words."""
    try:
        yield
    except SymsimpsonError:
        raise
    except SystemExit as error:
        raise InputError(f"{what}: it calls sys.exit({error.code!r}).\n{remedy}") from None
    except Exception as error:
        raise InputError(f"{what}: {type(error).__name__}: {error}.\n{remedy}") from error
