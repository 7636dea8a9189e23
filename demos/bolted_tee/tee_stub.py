# SPDX-License-Identifier: MIT
"""Resistance of a T-stub with one row of two bolts, as EN 1993-1-8 estimates it.

Three failure modes combine plastic hinges in the flange, at the web and at the bolts, with failure
of the bolts. Partial factors are 1. Source: EN 1993-1-8:2005, 6.2.4, tables 6.2 and 6.4 (a single
row, without stiffeners).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

LEVER = 1.25  # largest distance of the prying force from the bolt, over m


@dataclass(frozen=True)
class TeeStub:
    """Effective lengths, lever arm and resistances of a T-stub."""

    length_1: float  # effective length of mode 1: least of 2 pi m, 4 m + 1.25 e and the width
    length_2: float  # of mode 2, without the circular pattern 2 pi m
    lever: float  # n = min(e, 1.25 m), from the bolt to the prying force
    mode_1: float  # the flange yields: F_1 = 4 M_1/m
    mode_2: float  # the flange yields and the bolts fail: (2 M_2 + n sum F_t)/(m + n)
    mode_3: float  # the bolts fail: sum F_t

    @property
    def resistance(self) -> float:
        """The smallest of the three."""
        return min(self.mode_1, self.mode_2, self.mode_3)


def tee_stub(
    m: float, e: float, thickness: float, width: float, yield_stress: float, bolt: float
) -> TeeStub:
    """Return the resistances of a T-stub with two bolts.

    With the plastic moment of the flange M = 1/4 l t^2 f_y over an effective length l.

    Args:
        m: from the bolt to the hinge at the web, 0.8 times the fillet before it.
        e: from the bolt to the edge of the flange.
        thickness: t of the flange.
        width: of the flange that belongs to the row, which bounds the effective lengths.
        yield_stress: f_y of the flange.
        bolt: F_t, strength of one bolt in tension.

    >>> round(tee_stub(30.0, 30.0, 10.0, 40.0, 240.0, 60e3).mode_1)
    32000
    """
    straight = min(4.0 * m + 1.25 * e, width)
    lengths = min(2.0 * np.pi * m, straight), straight
    M_1, M_2 = (0.25 * length * thickness**2 * yield_stress for length in lengths)
    n = min(e, LEVER * m)
    modes = 4.0 * M_1 / m, (2.0 * M_2 + n * 2.0 * bolt) / (m + n), 2.0 * bolt
    return TeeStub(*lengths, n, *modes)
