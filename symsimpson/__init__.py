"""Variational integrators from kinetic and potential energy.

Declare T and V in SymPy; get a compiled, symplectic stepper of order two, four or more.

>>> import symsimpson as ss
>>> stepper = ss.compile(ss.systems.double_pendulum(), scheme="simpson")
>>> run = stepper.integrate([0.8, 1.0], p0=[0, 0], h=0.01, t_end=10.0)
>>> run
Trajectory(double_pendulum, simpson: 1000 steps of h=0.01, 1001 states stored, SUCCESS)
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from symsimpson.api import compile, generate, load, resume
    from symsimpson.bench.work_precision import work_precision
    from symsimpson.errors import (
        ConvergenceError,
        GenerationError,
        InputError,
        Interrupted,
        ModelError,
        ResolutionWarning,
        SchemeError,
        StabilityWarning,
        StaleKernelError,
        StorageError,
        SymsimpsonError,
    )
    from symsimpson.mechanics import catalogue as systems
    from symsimpson.mechanics.arms import Link, serial_arm
    from symsimpson.mechanics.coordinates import coordinates, momenta
    from symsimpson.mechanics.system import MechanicalSystem
    from symsimpson.runtime.ensembles.ensemble import Ensemble
    from symsimpson.runtime.results.archive import open_trajectory
    from symsimpson.runtime.results.events import Events
    from symsimpson.runtime.results.states import States
    from symsimpson.runtime.results.status import Status
    from symsimpson.runtime.results.trajectory import Trajectory
    from symsimpson.runtime.stepper import Stepper
    from symsimpson.schemes.composition import Composition, composition
    from symsimpson.schemes.scheme import MIDPOINT, SIMPSON, Scheme, galerkin

__version__ = "0.1.0"

#: Where each public name lives; it is imported when first used, so that the core starts fast.
_HOME = {
    "compile": "api",
    "generate": "api",
    "Choice": "analysis.choose",
    "choose": "analysis.choose",
    "load": "api",
    "resume": "api",
    "ConvergenceError": "errors",
    "GenerationError": "errors",
    "Link": "mechanics.arms",
    "serial_arm": "mechanics.arms",
    "InputError": "errors",
    "Interrupted": "errors",
    "ModelError": "errors",
    "ResolutionWarning": "errors",
    "SchemeError": "errors",
    "StabilityWarning": "errors",
    "StaleKernelError": "errors",
    "StorageError": "errors",
    "SymsimpsonError": "errors",
    "coordinates": "mechanics.coordinates",
    "momenta": "mechanics.coordinates",
    "MechanicalSystem": "mechanics.system",
    "Ensemble": "runtime.ensembles.ensemble",
    "Status": "runtime.results.status",
    "Stepper": "runtime.stepper",
    "Trajectory": "runtime.results.trajectory",
    "States": "runtime.results.states",
    "Events": "runtime.results.events",
    "open_trajectory": "runtime.results.archive",
    "Composition": "schemes.composition",
    "composition": "schemes.composition",
    "MIDPOINT": "schemes.scheme",
    "SIMPSON": "schemes.scheme",
    "Scheme": "schemes.scheme",
    "galerkin": "schemes.scheme",
    "work_precision": "bench.work_precision",
}

__all__ = [
    "MIDPOINT",
    "SIMPSON",
    "Choice",
    "Composition",
    "ConvergenceError",
    "Ensemble",
    "Events",
    "GenerationError",
    "InputError",
    "Interrupted",
    "Link",
    "MechanicalSystem",
    "ModelError",
    "ResolutionWarning",
    "Scheme",
    "SchemeError",
    "StabilityWarning",
    "StaleKernelError",
    "States",
    "Status",
    "Stepper",
    "StorageError",
    "SymsimpsonError",
    "Trajectory",
    "choose",
    "compile",
    "composition",
    "coordinates",
    "galerkin",
    "generate",
    "load",
    "momenta",
    "open_trajectory",
    "resume",
    "serial_arm",
    "systems",
    "work_precision",
]


def __getattr__(name: str) -> Any:
    if name == "systems":
        value: Any = importlib.import_module("symsimpson.mechanics.catalogue")
    elif name in _HOME:
        value = getattr(importlib.import_module(f"symsimpson.{_HOME[name]}"), name)
    else:
        raise AttributeError(f"module 'symsimpson' has no attribute {name!r}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted([*__all__, "__version__"])
