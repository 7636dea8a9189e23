# SPDX-License-Identifier: MIT
"""Names of the array types of the package, and the round-off of their numbers."""

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
TINY = float(np.finfo(np.float64).tiny)
"""Least divisor, in place of zero."""
UNDERFLOW = float(np.sqrt(TINY))
"""Norm below which squares underflow: no solver reduces such forces."""
ROUND_OFF = 16 * EPS
"""Error of a sum of products over the size of its terms, such as of a matrix times a vector."""
HALF_OF_DIGITS = float(np.sqrt(EPS))
"""Error of what comes from a difference of squares."""
QUARTER_OF_DIGITS = float(np.sqrt(HALF_OF_DIGITS))
"""Share of its terms below which a difference has lost three quarters of its digits."""
SAME = HALF_OF_DIGITS * QUARTER_OF_DIGITS
"""Relative difference of values that are equal but were calculated in different ways."""
CHUNK = 2**14
"""Rows of numbers that are treated at a time: some MB, of which calls cost little."""
LIMIT = 2 * int(np.finfo(np.float64).nmant)
"""Most iterations of loops that end by a criterion of their own.

Bisection takes one for each binary digit, after as many doublings to find its interval. Of other
loops none has been seen to take half as many.
"""


def flat(values: Floats) -> Floats:
    """Rows (n, size) of entries of any shape, also none.

    >>> flat(np.zeros((0, 2, 3))).shape
    (0, 6)
    """
    return values.reshape(len(values), int(np.prod(values.shape[1:])))


def place(x: Floats) -> str:
    """Coordinates (d,) for messages.

    >>> place(np.array([1 / 3, 20000.0]))
    '(0.3333, 2e+04)'
    """
    return f"({', '.join(f'{v:.4g}' for v in x)})"
