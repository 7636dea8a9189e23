# SPDX-License-Identifier: MIT
"""Round-off relative to a facet's size, and numba's options: touch kernels after changes here."""

import numpy as np

from dolfinx_mortar.common.arrays import EPS

ROUND_OFF = 512 * EPS
"""Error of a length relative to its facet, for coordinates up to some hundred times as large; where
errors add up, a small multiple of it is used."""

KERNEL = {
    "cache": True,
    "error_model": "numpy",
    "fastmath": {"contract"},
    "no_cfunc_wrapper": True,
}
"""Of functions that clip and place: functions with the same options share compiled code."""
FIRST, SECOND, THIRD = (np.int64(i) for i in range(3))
"""Places: a literal number has a type of its own, and its callees would compile for each."""
