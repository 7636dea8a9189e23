# SPDX-License-Identifier: MIT
"""Outlines with a known form."""

import numpy as np

RECTANGLE = [(-1.0, -0.5), (1.0, -0.5), (1.0, 0.5), (0.2, 0.5), (-1.0, 0.5)]


def disc(n, radius=1.0, centre=(0.1, 0.2), share=1.0, uneven=0.3):
    """Return points of a circle, counterclockwise from the lowest one, at uneven distances."""
    t = np.arange(n) / n
    angle = 2.0 * np.pi * share * (t + uneven / (2.0 * np.pi) * np.sin(2.0 * np.pi * t)) - np.pi / 2
    return np.asarray(centre) + radius * np.column_stack([np.cos(angle), np.sin(angle)])
