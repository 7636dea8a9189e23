# SPDX-License-Identifier: MIT
"""Names of the array types that travel through the package, and the round-off of their numbers."""

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]
Bools = npt.NDArray[np.bool_]
Ints = npt.NDArray[np.int32]
"""Local indices."""
Longs = npt.NDArray[np.int64]
"""Global indices."""
Actives = npt.NDArray[np.int8]
"""State of bounded unknowns: +1 at the upper bound, -1 at the lower one, 0 free."""

EPS = float(np.finfo(np.float64).eps)
ROUND_OFF = 16 * EPS
"""Error of a sum of products over the size of its terms, such as of a matrix times a vector."""
QUARTER_OF_DIGITS = float(np.sqrt(np.sqrt(EPS)))
"""What has lost more than three quarters of its digits is smaller than this share of its terms."""
