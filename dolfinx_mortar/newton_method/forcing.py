# SPDX-License-Identifier: MIT
"""The forcing term: how accurately the next QP has to be solved (Eisenstat and Walker 1996)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dolfinx_mortar.newton_method.residuals import Residuals

# The error allowed to a QP, as a share of the residual that the contraction seen so far promises
# for the next iterate (Eisenstat and Walker 1996). Digits are cheap with a factorisation only.
FORCING = {"direct": 1e-3, "iterative": 1e-1}
# The first QP of a nonlinear step, before any contraction is known.
FIRST_QP = {"direct": 1e-4, "iterative": 1e-2}
# A QP need not be more accurate than this share of what the step allows.
QP_SHARE = 0.1
# Round-off: no QP is solved more accurately.
FINEST = 1e-13
# What an iteration that has not lowered the residual takes off the error of the next QP: the error
# may be the cause. Where a body flows, small forces that a QP misses are large motions.
STALLED = 0.1
# A linear law is solved by one QP per contact state, whose error is that of the step.
STEP_SHARE = 1e-3


def tightest(rtol: float) -> float:
    """Return the smallest relative tolerance of a QP that makes sense in a step of tolerance rtol.

    >>> tightest(1e-6)
    1e-09
    """
    return max(FINEST, STEP_SHARE * rtol)


def next_tolerance(kind: str, rtol: float, size: float, residuals: Sequence[Residuals]) -> float:
    """Return the relative tolerance of the next QP of a nonlinear step.

    The error allowed is a share of the residual that the last contraction promises for the next
    iterate, in a tail that gains one digit an iteration one digit and a bit.

    Args:
        kind: "direct" or "iterative".
        rtol: tolerance of the step.
        size: norm of the QP's right-hand side.
        residuals: of the iterates so far.

    >>> next_tolerance("iterative", 1e-6, 1.0, [])
    0.01
    """
    if not residuals:
        return max(tightest(rtol), FIRST_QP[kind])
    last = residuals[-1]
    before = residuals[-2].excess if len(residuals) > 1 else np.inf
    contraction = min(1.0, last.excess / before) if 0.0 < before < np.inf else 1.0
    least = int(np.argmin([residual.excess for residual in residuals]))
    stalled = len(residuals) - 1 - least
    share = FORCING[kind] * STALLED**stalled * contraction
    allowed = max(QP_SHARE, share * last.excess) * last.limit
    relative = allowed / size if size > 0.0 else 1.0
    return float(max(tightest(rtol), min(FIRST_QP[kind], relative)))
