# SPDX-License-Identifier: MIT
"""Symmetric 3x3 tensors and how they are stored.

A plane problem stores the four components that can be non-zero, a spatial problem six. The stored
shear is the tensor component (not the engineering strain) and is stored once.

==== ==========================
gdim stored components, in order
==== ==========================
2    xx, yy, zz, xy
3    xx, yy, zz, xy, yz, xz
==== ==========================
"""

import numpy as np

import ufl
from dolfinx_mortar.arrays import Floats
from ufl.core.expr import Expr

COMPONENTS = {2: ("xx", "yy", "zz", "xy"), 3: ("xx", "yy", "zz", "xy", "yz", "xz")}
# Row and column of each entry of F or P that may be non-zero, which are stored in this order.
GRADIENT = {
    2: ((0, 0), (0, 1), (1, 0), (1, 1), (2, 2)),
    3: tuple((i, j) for i in range(3) for j in range(3)),
}
# Row and column of each stored component.
INDEX = tuple(("xyz".index(name[0]), "xyz".index(name[1])) for name in COMPONENTS[3])


def from_components(c: Expr) -> Expr:
    """Return the 3x3 tensor whose stored components are c (4 or 6 of them)."""
    xx, yy, zz, xy = (c[i] for i in range(4))
    yz, xz = (c[4], c[5]) if c.ufl_shape == (6,) else (0, 0)
    return ufl.as_tensor([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def to_components(tensor: Expr, size: int) -> Expr:
    """Return the vector of the first `size` (4 or 6) stored components of a 3x3 tensor."""
    return ufl.as_vector([tensor[i, j] for i, j in INDEX[:size]])


def frobenius_norm(c: np.ndarray) -> np.ndarray:
    """Return the Frobenius norm sqrt(T:T) of tensors stored as (..., 4 or 6), shear counted twice.

    >>> float(frobenius_norm(np.array([1.0, 0.0, 0.0, 2.0])))
    3.0
    """
    return np.sqrt(double_contraction(c, c))


def double_contraction(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return S:T of tensors stored as (..., 4 or 6), shear counted twice.

    >>> float(double_contraction(np.array([1.0, 0.0, 0.0, 2.0]), np.array([3.0, 0.0, 0.0, 4.0])))
    19.0
    """
    product = a * b
    return np.sum(product[..., :3], axis=-1) + 2 * np.sum(product[..., 3:], axis=-1)


def vector_norm(c: np.ndarray) -> np.ndarray:
    """Return the Euclidean norm of the stored components (..., 4 or 6), shear counted once.

    Not invariant under rotation; figures of the literature plot it of the back stress as
    "hardening".

    >>> float(vector_norm(np.array([3.0, 0.0, 0.0, 4.0])))
    5.0
    """
    return np.linalg.norm(c, axis=-1)


def von_mises(stress: np.ndarray) -> np.ndarray:
    """Return sqrt(3/2) |dev sigma| of stresses stored as (..., 4 or 6).

    >>> round(float(von_mises(np.array([450.0, 0.0, 0.0, 0.0]))), 9)
    450.0
    """
    deviator = stress.copy()
    deviator[..., :3] -= stress[..., :3].mean(axis=-1, keepdims=True)
    return np.sqrt(1.5) * frobenius_norm(deviator)


def tensor_of(components: Floats) -> Floats:
    """Return symmetric tensors (q, 3, 3) of stored components (q, 4 or 6).

    >>> tensor_of(np.array([[1.0, 2.0, 3.0, 4.0]]))[0].tolist()
    [[1.0, 4.0, 0.0], [4.0, 2.0, 0.0], [0.0, 0.0, 3.0]]
    """
    tensors = np.zeros((len(components), 3, 3))
    for k, (i, j) in enumerate(INDEX[: components.shape[1]]):
        tensors[:, i, j] = tensors[:, j, i] = components[:, k]
    return tensors


def stored(tensors: Floats, size: int = 6) -> Floats:
    """Return the first `size` (4 or 6) stored components (q, size) of tensors (q, 3, 3)."""
    rows, columns = zip(*INDEX[:size], strict=True)
    return np.asarray((tensors[:, rows, columns] + tensors[:, columns, rows]) / 2)


def mean_of_shears(tangent: Floats) -> Floats:
    """Return derivatives (q, 3, 3, 3, 3) by nine entries with the means of kl and lk."""
    mean = tangent.copy()
    for k, m in INDEX[3:]:
        mean[..., k, m] = mean[..., m, k] = (tangent[..., k, m] + tangent[..., m, k]) / 2
    return mean
