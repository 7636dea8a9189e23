# SPDX-License-Identifier: MIT
"""Orthonormal frames of slave nodes: the normal first, prescribed axes among the tangents."""

from dataclasses import dataclass

import numpy as np

from dolfinx_mortar.arrays import Bools, Floats, Ints


@dataclass(frozen=True)
class Frame:
    """Directions at the owned slave nodes, and which of them an interface constrains."""

    R: Floats  # (n, d, d) orthonormal, the columns are the directions
    slot: Ints  # (n, d) column of R that is a prescribed Cartesian direction, else -1
    directions: Bools  # (n, d) columns of R that are constrained
    normals: Floats  # (n, d)


def create_frames(normals: Floats, fixed: Bools) -> tuple[Floats, Ints]:
    """Return orthonormal frames with the normal first and prescribed axes among the tangents.

    Args:
        normals: (n, d) unit normals; zero in every prescribed direction.
        fixed: (n, d) True where a Cartesian direction is prescribed.

    Returns:
        R (n, d, d) with the frame vectors as columns and slot (n, d): the column of R that is the
        Cartesian axis i where ``fixed[:, i]``, else -1.

    >>> R, slot = create_frames(np.array([[0.0, -1.0]]), np.array([[True, False]]))
    >>> R[0].tolist(), slot[0].tolist()
    ([[0.0, 1.0], [-1.0, 0.0]], [1, -1])
    """
    n, d = normals.shape
    # The axis closest to n, none of the prescribed ones, is left out, so that [n, axes] is never
    # singular. The others keep their order: sorted by their share in n, tangents would swap when n
    # turns a little, and old levels of multigrid would know them no more (37 iterations for 23).
    order = np.argsort(np.abs(normals) - 2.0 * fixed, axis=1, kind="stable")[:, : d - 1]
    order = np.sort(order, axis=1)
    columns = np.concatenate([normals[:, None, :], np.eye(d)[order]], axis=1)
    R, upper = np.linalg.qr(np.swapaxes(columns, 1, 2))
    R = R * np.sign(np.einsum("nii->ni", upper))[:, None, :]
    slot = np.full((n, d), -1, dtype=np.int32)
    np.put_along_axis(slot, order, np.arange(1, d, dtype=np.int32)[None, :], axis=1)
    return R + 0.0, np.where(fixed, slot, -1).astype(np.int32)


def normal_frames(normals: Floats, kept: Bools, fixed: Bools) -> tuple[Floats, Ints, Bools]:
    """Return frames of which the normal is constrained at kept nodes; Cartesian ones elsewhere.

    Args:
        normals: (n, d) unit normals; zero in every prescribed direction.
        kept: (n,) nodes that carry a multiplier.
        fixed: (n, d) True where a Cartesian direction is prescribed.

    Returns:
        R (n, d, d) and slot (n, d) as of `create_frames`, and the constrained directions (n, d).
    """
    n, d = normals.shape
    R, axes = np.tile(np.eye(d), (n, 1, 1)), np.arange(d, dtype=np.int32)
    slot = np.where(fixed, axes, -1).astype(np.int32)
    R[kept], slot[kept] = create_frames(normals[kept], fixed[kept])
    return R, slot, kept[:, None] & (axes == 0)
