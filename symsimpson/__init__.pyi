# Every public name and where it lives: type checkers read this list, and so does the package.

from . import systems as systems
from .analysis.certificate import Certificate as Certificate
from .analysis.choose import Choice as Choice
from .analysis.choose import choose as choose
from .analysis.costs import StepCosts as StepCosts
from .analysis.costs import step_costs as step_costs
from .api import compile as compile
from .api import generate as generate
from .api import load as load
from .api import resume as resume
from .bench.record import WorkPrecision as WorkPrecision
from .bench.work_precision import work_precision as work_precision
from .derivation import Report as Report
from .errors import ConvergenceError as ConvergenceError
from .errors import GenerationError as GenerationError
from .errors import InputError as InputError
from .errors import Interrupted as Interrupted
from .errors import ModelError as ModelError
from .errors import ResolutionWarning as ResolutionWarning
from .errors import SchemeError as SchemeError
from .errors import StabilityWarning as StabilityWarning
from .errors import StaleKernelError as StaleKernelError
from .errors import StorageError as StorageError
from .errors import SymsimpsonError as SymsimpsonError
from .mechanics.arms import Link as Link
from .mechanics.arms import serial_arm as serial_arm
from .mechanics.coordinates import coordinates as coordinates
from .mechanics.coordinates import momenta as momenta
from .mechanics.coordinates import time as time
from .mechanics.structure import Structure as Structure
from .mechanics.system import MechanicalSystem as MechanicalSystem
from .plotting.animate import Animation as Animation
from .runtime.ensembles.ensemble import Ensemble as Ensemble
from .runtime.results.archive import open_trajectory as open_trajectory
from .runtime.results.events import Events as Events
from .runtime.results.interpolate import DenseOutput as DenseOutput
from .runtime.results.states import States as States
from .runtime.results.status import Status as Status
from .runtime.results.trajectory import Trajectory as Trajectory
from .runtime.runs.driving import samples as samples
from .runtime.runs.loop import ControlLoop as ControlLoop
from .runtime.stepper import Stepper as Stepper
from .schemes.composition import Composition as Composition
from .schemes.composition import composition as composition
from .schemes.scheme import MIDPOINT as MIDPOINT
from .schemes.scheme import SIMPSON as SIMPSON
from .schemes.scheme import Scheme as Scheme
from .schemes.scheme import galerkin as galerkin

__version__: str
__all__: list[str]
