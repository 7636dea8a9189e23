# SPDX-License-Identifier: MIT
"""What kernels have in common: round-off relative to the size of a facet, and numba's options.

Numba compiles both in and does not notice a change here: touch the files with kernels, too.
"""

import numpy as np

from dolfinx_mortar.arrays import EPS

ROUND_OFF = 512 * EPS
"""Error of a length relative to its facet, where coordinates are up to some hundred times as large.

Where errors add up, a small multiple of it is used.
"""

KERNEL = {
    "cache": True,
    "error_model": "numpy",
    "fastmath": {"contract"},
    "no_cfunc_wrapper": True,
}
"""Of functions that clip and place: those with the same options share what numba makes of them."""
FIRST, SECOND, THIRD = (np.int64(i) for i in range(3))
"""Places: a literal number has a type of its own, so that what takes it compiles for each."""
