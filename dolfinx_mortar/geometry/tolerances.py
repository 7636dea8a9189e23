# SPDX-License-Identifier: MIT
"""Round-off of the geometry, relative to the size of a facet.

Numba compiles it in and does not notice a change here: touch the files with kernels, too.
"""

from dolfinx_mortar.arrays import EPS

ROUND_OFF = 512 * EPS
"""Error of a length relative to its facet, where coordinates are up to some hundred times as large.

Where errors add up, a small multiple of it is used.
"""
