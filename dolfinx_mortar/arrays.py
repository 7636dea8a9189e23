# SPDX-License-Identifier: MIT
"""Names of the array types that travel through the package."""

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
