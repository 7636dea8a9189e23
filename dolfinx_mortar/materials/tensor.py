# SPDX-License-Identifier: MIT
"""Symmetric 3x3 tensors and their stored components.

The stored shear is the tensor component (not the engineering strain), once.
"""

from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np

import ufl
from dolfinx_mortar.common.arrays import Floats
from ufl.core.expr import Expr

COMPONENTS = {2: ("xx", "yy", "zz", "xy"), 3: ("xx", "yy", "zz", "xy", "yz", "xz")}
# Row and column of the entries of F or P that may be non-zero, in the stored order.
GRADIENT = {
    2: ((0, 0), (0, 1), (1, 0), (1, 1), (2, 2)),
    3: tuple((i, j) for i in range(3) for j in range(3)),
}
INDEX = tuple(("xyz".index(name[0]), "xyz".index(name[1])) for name in COMPONENTS[3])


def from_components(c: Expr) -> Expr:
    """Tensor (3, 3) of stored components c (3, 4 or 6)."""
    return from_entries(INDEX[: c.ufl_shape[0]], c, True)


def from_entries(
    entries: Sequence[tuple[int, int]], values: Iterable[Any], symmetric: bool
) -> Expr:
    """Tensor (3, 3) of the values of some entries (and their mirrors), zero elsewhere."""
    rows: list[list[Any]] = [[ufl.as_ufl(0.0)] * 3 for _ in range(3)]
    for (i, j), value in zip(entries, values, strict=True):
        rows[i][j] = value
        rows[j][i] = value if symmetric else rows[j][i]
    return ufl.as_tensor(rows)


def to_components(tensor: Expr, size: int) -> Expr:
    """The first `size` (4 or 6) stored components of a 3x3 tensor."""
    return ufl.as_vector([tensor[i, j] for i, j in INDEX[:size]])


def frobenius_norm(c: np.ndarray) -> np.ndarray:
    """Frobenius norm sqrt(T:T) of tensors stored as (..., 4 or 6), shear counted twice.

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
    """Euclidean norm of the stored components (..., 4 or 6), shear counted once (not invariant).

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


def tensor_of(components: Floats, entries: Sequence[tuple[int, int]] = INDEX) -> Floats:
    """Tensors (q, 3, 3) of some entries (q, ..), and their mirrors unless these are given.

    >>> tensor_of(np.array([[1.0, 2.0, 3.0, 4.0]]))[0].tolist()
    [[1.0, 4.0, 0.0], [4.0, 2.0, 0.0], [0.0, 0.0, 3.0]]
    """
    tensors = np.zeros((len(components), 3, 3))
    rows, columns = np.array(entries[: components.shape[1]]).T
    tensors[:, columns, rows] = components
    tensors[:, rows, columns] = components
    return tensors


def stored(tensors: Floats, size: int = 6) -> Floats:
    """The first `size` (3, 4 or 6) stored components of tensors (q, 3, 3)."""
    rows, columns = zip(*INDEX[:size], strict=True)
    return (tensors[:, rows, columns] + tensors[:, columns, rows]) / 2


def mean_of_shears(tangent: Floats) -> Floats:
    """Average derivatives (q, 3, 3, 3, 3) over kl and lk."""
    return (tangent + tangent.swapaxes(3, 4)) / 2


def upper_triangle(size: int) -> list[tuple[int, int]]:
    """Row and column of the upper triangle of a matrix, row by row."""
    return [(i, j) for i in range(size) for j in range(i, size)]


def contract(
    entries: Sequence[tuple[int, int]],
    moduli: Callable[[int, int], Expr],
    direction: Expr,
    *,
    symmetric: bool,
) -> Expr:
    """Return C : direction with C_ab = moduli(a, b) for a <= b, of entries a, b of 3x3 tensors.

    A `symmetric` tensor has each of its entries below the diagonal, too.
    """
    sums = []
    for a in range(len(entries)):
        terms = []
        for b, (k, m) in enumerate(entries):
            times = 2 if symmetric and k != m else 1
            terms.append(moduli(min(a, b), max(a, b)) * times * direction[k, m])
        sums.append(sum(terms))
    return from_entries(entries, sums, symmetric)
