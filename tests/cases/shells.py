# SPDX-License-Identifier: MIT
"""Two tied shells: octants of spheres, and rings, with different numbers of facets."""

from itertools import permutations

import numpy as np

from dolfinx_mortar.meshing.two_bodies import all_at, two_bodies

INNER, SLAVE, MASTER, OUTER = 1, 2, 3, 4  # circles or spheres from inside; 5, 6, 7: x, y, z = 0
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


def _octant(n):
    """Return points on an octant of the unit sphere and its 3 n^2 quadrilaterals."""
    t = np.tan(np.linspace(0, np.pi / 4, n + 1))
    a, b = (v.ravel() for v in np.meshgrid(t, t, indexing="ij"))
    one = np.ones_like(a)
    x = np.concatenate([np.column_stack(c) for c in ((one, a, b), (b, one, a), (a, b, one))])
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    first = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).ravel()
    quads = first[:, None] + np.array([0, n + 1, 1, n + 2])
    quads = np.concatenate([quads + k * (n + 1) ** 2 for k in range(3)])
    _, index, inverse = np.unique(
        np.round(x, 9) + 0.0, axis=0, return_index=True, return_inverse=True
    )
    return x[index], inverse.ravel()[quads]


def _shell(radii, n, layers, cell):
    """Return nodes and cells between two radii; six tetrahedra per hexahedron."""
    x, quads = _octant(n)
    points = np.concatenate([r * x for r in np.linspace(*radii, layers + 1)])
    cells = [np.hstack([quads + k * len(x), quads + (k + 1) * len(x)]) for k in range(layers)]
    cells = np.concatenate(cells)
    if cell == "tetrahedron":
        paths = [np.cumsum([0] + [1 << i for i in order]) for order in permutations(range(3))]
        cells = np.concatenate([cells[:, path] for path in paths])
    return points, cells


def octants(comm, radii, counts, layers, cell):
    """Return the mesh of two shells, radii[0] to radii[1] to radii[2], and its facet tags."""
    bounds = radii[:2], radii[1:]
    parts = [_shell(b, n, layers, cell) for b, n in zip(bounds, counts, strict=True)]

    def sides(inner, x):
        on = [all_at(np.linalg.norm(x, axis=2), r, 1e-9) for r in radii]
        marks = [on[0], on[1] & inner, on[1] & ~inner, on[2]]
        marks += [all_at(x[:, :, i], 0.0, 1e-9) for i in range(3)]
        return dict(zip("1234567", marks, strict=True))

    found = two_bodies(comm, lambda: parts, cell, "shells", ("inner", "outer"), sides)
    return found.mesh, found.facet_tags


def lame_pressure(radii, d):
    """Return the pressure at radii[1] of one material under 1 from outside, nothing inside."""
    a, b, c = radii
    return (1 - (a / b) ** d) / (1 - (a / c) ** d)
