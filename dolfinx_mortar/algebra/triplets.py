# SPDX-License-Identifier: MIT
"""Matrices assembled from triplets on a fixed pattern, which petsc4py 3.22 does not wrap.

PETSc sorts the triplets and prepares the exchange of off-rank rows once; each later assembly is one
pass over the values. The sum of repeated entries does not depend on the order of messages.
"""

import ctypes

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from dolfinx_mortar.arrays import Ints, Longs

# This also finds the symbols of the libraries that petsc4py is linked with.
_lib = ctypes.CDLL(PETSc.__file__)


def _call(name: str, *arguments: object) -> None:
    """Call a PETSc function and raise its error."""
    error = getattr(_lib, name)(*arguments)
    if error:
        raise PETSc.Error(error)


def set_pattern(A: PETSc.Mat, rows: npt.ArrayLike, columns: npt.ArrayLike) -> None:
    """Fix the pattern of A to the global entries (rows[k], columns[k]) (collective).

    Args:
        A: AIJ matrix with sizes and type set.
        rows: global row (e,) of each entry, of any rank.
        columns: global column (e,) of each entry.
    """
    i, j = (np.array(v, dtype=PETSc.IntType).ravel() for v in (rows, columns))  # PETSc reorders
    assert i.size == j.size
    for indices, size in zip((i, j), A.getSize(), strict=True):  # PETSc would write past the end
        assert indices.size == 0 or (indices.min() >= 0 and indices.max() < size)
    pointers = (ctypes.c_void_p(v.ctypes.data) for v in (i, j))
    count = ctypes.c_ssize_t(i.size)
    _call("MatSetPreallocationCOO", ctypes.c_void_p(A.handle), count, *pointers)


def set_values(A: PETSc.Mat, values: npt.ArrayLike) -> None:
    """Set A to the sum of the values (e,) at the entries of its pattern (collective)."""
    v = np.ascontiguousarray(values, dtype=PETSc.ScalarType).ravel()
    pointer = ctypes.c_void_p(v.ctypes.data)
    _call(
        "MatSetValuesCOO",
        ctypes.c_void_p(A.handle),
        pointer,
        ctypes.c_int(PETSc.InsertMode.INSERT_VALUES),
    )


def rows_and_columns(A: PETSc.Mat) -> tuple[Ints, Longs]:
    """Return owned row (local) and column (global) of every entry in the pattern of A."""
    indptr, columns, _ = A.getValuesCSR()
    rows = np.repeat(np.arange(len(indptr) - 1, dtype=np.int32), np.diff(indptr))
    return rows, columns.astype(np.int64)
