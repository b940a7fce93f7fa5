"""Arrays of numbers, as annotations name them."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
#: float64, or numbers of mpmath in an object array.
Reals = NDArray[Any]
#: Positions and momenta.
State = tuple[Floats, Floats]
