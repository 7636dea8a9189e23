# SPDX-License-Identifier: MIT
"""Sectors of shells from blocks, and the tag of the outer one of nested circles."""

import numpy as np

OUTER = 4
RADIUS = 2.0  # of the interface of sectors


def to_sphere(x):
    """Map (a, b, radius - 2), with a and b from 0 to 1, to a sector of a spherical shell."""
    direction = np.column_stack([0.8 * (x[:, :2] - 0.5), np.ones(len(x))])
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    return (RADIUS + x[:, 2:]) * direction


def to_arc(x):
    """Map (a, .., radius - 2) to a sector of a ring, or of a tube."""
    angle, radius = 0.8 * (x[:, 0] - 0.5), RADIUS + x[:, -1]
    return np.column_stack([radius * np.sin(angle), *x[:, 1:-1].T, radius * np.cos(angle)])
