# SPDX-License-Identifier: MIT
"""The one round-off of the geometry, in parts of the facet that is looked at.

Numba compiles it in and does not notice a change here: touch the files with kernels, too.
"""

import numpy as np

EPS = float(np.finfo(float).eps)
ROUND_OFF = 512 * EPS
"""Error of a length over the size of its facet: facets may lie some hundred sizes off the origin.

Where errors add up, a small multiple of it stands in the text.
"""
HALF_OF_DIGITS = float(np.sqrt(EPS))
"""Error of what comes from a difference of squares; what has no more digits left is nothing."""
TINY = float(np.finfo(float).tiny)
"""Added to what must not be zero."""
