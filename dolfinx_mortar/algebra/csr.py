# SPDX-License-Identifier: MIT
"""Entries of AIJ matrices in the format CSR, read and written as whole arrays by PETSc's library.

petsc4py's `getValuesCSR` and `setValuesCSR` call PETSc once for each row, a hundred times slower.
"""

from __future__ import annotations

import ctypes
from collections.abc import Iterator
from contextlib import contextmanager

from petsc4py import PETSc

import numba
import numpy as np
import scipy

from dolfinx_mortar.arrays import Floats, Ints

# the libraries that petsc4py is linked with
_lib = ctypes.CDLL(PETSc.__file__)


def has(name: str) -> bool:
    """Whether the library exports a function: petsc4py may hide its symbols."""
    return hasattr(_lib, name)


def call(name: str, *arguments: object) -> None:
    """Call a function and raise its error."""
    error = getattr(_lib, name)(*arguments)
    if error:
        raise PETSc.Error(error)


def csr_of(A: PETSc.Mat) -> tuple[Ints, Ints, Floats]:
    """Copies of the entries of owned rows: their starts, global columns, and values."""
    if A.getType() != "seqaij":
        return A.getValuesCSR()
    start, columns = A.getRowIJ()
    with _stored(A, "Read", len(columns)) as values:
        return start, columns, values.copy()


def owned_rows(A: PETSc.Mat) -> scipy.sparse.csr_array:
    """Copy of the owned rows, with global columns."""
    start, columns, values = csr_of(A)
    return scipy.sparse.csr_array((values, columns, start), shape=(len(start) - 1, A.getSize()[1]))


def set_csr(A: PETSc.Mat, start: Ints, columns: Ints, values: Floats) -> None:
    """Set all values (e,) of owned rows, within the pattern of the matrix; collective.

    Args:
        A: assembled.
        start: (rows + 1,) first entry of each row.
        columns: (e,) global columns of all entries, ascending in each row.
        values: (e,)
    """
    if A.getType() != "seqaij":
        A.setValuesCSR(start, columns, values)
        A.assemble()
        return
    with _stored(A, "Write", len(columns)) as stored:
        stored[:] = values


def add_blocks(A: PETSc.Mat, start: Ints, columns: Ints, blocks: Floats) -> None:
    """Add blocks (e, d, c) to a matrix on one rank; PETSc would search for each entry's place.

    Args:
        A: assembled.
        start: (rows of blocks + 1,) first block of each row.
        columns: (e,) columns of blocks, ascending in each row.
        blocks: their entries.

    Raises:
        ValueError: if the pattern of A lacks an entry; A is then partly filled.
    """
    rows, places = A.getRowIJ()
    with _stored(A, "", len(places)) as values:
        if not _add_blocks(rows, places, values, start, columns, blocks):
            raise ValueError("a matrix has no place for a block")


@numba.njit(cache=True)
def _add_blocks(rows, places, values, start, columns, blocks):  # type: ignore[no-untyped-def]
    """Add to the values of a matrix with ascending columns; whether all had a place."""
    d, c = blocks.shape[1:]
    for r in range(len(start) - 1):
        for i in range(d):
            p, end = rows[d * r + i], rows[d * r + i + 1]
            for e in range(start[r], start[r + 1]):
                while p < end and places[p] < c * columns[e]:
                    p += 1
                if p + c > end or places[p] != c * columns[e]:
                    return False
                for j in range(c):
                    values[p + j] += blocks[e, i, j]
                p += c
    return True


@contextmanager
def _stored(A: PETSc.Mat, access: str, count: int) -> Iterator[Floats]:
    """Lend the values of a matrix on one rank, for "Read", "Write", or "" for both."""
    if not count:
        yield np.zeros(0)
        return
    matrix, first = ctypes.c_void_p(A.handle), ctypes.POINTER(ctypes.c_double)()
    call(f"MatSeqAIJGetArray{access}", matrix, ctypes.byref(first))
    try:
        yield np.ctypeslib.as_array(first, shape=(count,))
    finally:
        call(f"MatSeqAIJRestoreArray{access}", matrix, ctypes.byref(first))
