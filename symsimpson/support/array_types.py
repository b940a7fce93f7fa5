"""Types of arrays for annotations."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
#: Array of float64, or an object array of mpmath numbers.
Reals = NDArray[Any]
#: Positions and momenta (q, p).
State = tuple[Floats, Floats]
