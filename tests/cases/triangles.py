# SPDX-License-Identifier: MIT
"""Surfaces of triangles with a known form, and files of them."""

import numpy as np
from scipy.spatial import ConvexHull

GOLDEN = (1.0 + 5.0**0.5) / 2.0


def ball(n, radius=1.0, centre=(0.0, 0.0, 0.0)):
    """Return points and 20 * 4^n triangles of a sphere: an icosahedron, its triangles halved."""
    near = np.array([[-1, GOLDEN], [1, GOLDEN], [-1, -GOLDEN], [1, -GOLDEN]])
    zero = np.zeros((4, 1))
    p = np.concatenate([np.hstack([near, zero]), np.hstack([zero, near])])
    p = np.concatenate([p, np.stack([near[:, 1], zero[:, 0], near[:, 0]], axis=1)])
    x = p[ConvexHull(p).simplices]
    inwards = np.linalg.det(x) < 0.0
    x[inwards] = x[inwards][:, ::-1]
    for _ in range(n):
        a, b, c = x[:, 0], x[:, 1], x[:, 2]
        ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
        parts = (a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)
        x = np.concatenate([np.stack(part, axis=1) for part in parts])
    _, first, place = np.unique(
        x.reshape(-1, 3).round(9), axis=0, return_index=True, return_inverse=True
    )
    points = x.reshape(-1, 3)[first]
    points = radius * points / np.linalg.norm(points, axis=1)[:, None] + np.asarray(centre)
    return points, place.reshape(-1, 3)


def box(low=(-1.0, -1.0, 0.0), high=(1.0, 1.0, 1.0)):
    """Return points and 12 triangles of a box."""
    points = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=float)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    triangles = [t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))]
    low, high = np.asarray(low), np.asarray(high)
    return low + points * (high - low), np.array(triangles)


def write_binary(path, points, triangles):
    """Write a binary STL file, with zero normals as some programs do."""
    record = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    records = np.zeros(len(triangles), record)
    records["corners"] = points[triangles]
    path.write_bytes(b" " * 80 + len(triangles).to_bytes(4, "little") + records.tobytes())


def write_text(path, points, triangles):
    """Write an STL file as text."""
    lines = ["solid made here"]
    for corners in points[triangles].astype(np.float32):
        rows = [f"vertex {x:.17g} {y:.17g} {z:.17e}" for x, y, z in corners]
        lines += ["facet normal 0 0 0", "outer loop", *rows, "endloop", "endfacet"]
    path.write_text("\n".join([*lines, "endsolid made here", ""]))
