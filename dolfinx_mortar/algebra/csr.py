# SPDX-License-Identifier: MIT
"""Entries of AIJ matrices in the format CSR, read and written as whole arrays by PETSc's library.

petsc4py's `getValuesCSR` and `setValuesCSR` call PETSc once for each row, empty or not: reading 4
thousand entries in 400 of 46 thousand rows takes 1.2 ms so, and .01 ms as arrays.
"""

from __future__ import annotations

import ctypes
from collections.abc import Iterator
from contextlib import contextmanager

from petsc4py import PETSc

import numpy as np
from scipy.sparse import csr_array

from dolfinx_mortar.arrays import Floats, Ints

# Symbols are looked up in the libraries that petsc4py itself is linked with.
_lib = ctypes.CDLL(PETSc.__file__)


def has(name: str) -> bool:
    """Tell whether the library shows a function: a petsc4py may hide its symbols."""
    return hasattr(_lib, name)


def call(name: str, *arguments: object) -> None:
    """Call a function and raise its error."""
    error = getattr(_lib, name)(*arguments)
    if error:
        raise PETSc.Error(error)


def csr_of(A: PETSc.Mat) -> tuple[Ints, Ints, Floats]:
    """Return copies of the entries of owned rows: their starts, global columns, and values."""
    if A.getType() != "seqaij":
        return A.getValuesCSR()
    start, columns = A.getRowIJ()
    with _stored(A, "Read", len(columns)) as values:
        return start, columns, values.copy()


def owned_rows(A: PETSc.Mat) -> csr_array:
    """Return a copy of the rows that this rank owns, with global columns."""
    start, columns, values = csr_of(A)
    return csr_array((values, columns, start), shape=(len(start) - 1, A.getSize()[1]))


def set_csr(A: PETSc.Mat, start: Ints, columns: Ints, values: Floats) -> None:
    """Set all values of owned rows, on the pattern that the matrix has; collective.

    Args:
        A: the matrix, assembled.
        start: (rows + 1,) first entry of each row.
        columns: (e,) global columns of all entries, ascending in each row.
        values: (e,) their values.
    """
    if A.getType() != "seqaij":
        A.setValuesCSR(start, columns, values)
        A.assemble()
        return
    with _stored(A, "Write", len(columns)) as stored:
        stored[:] = values


@contextmanager
def _stored(A: PETSc.Mat, access: str, count: int) -> Iterator[Floats]:
    """Lend the values of a matrix on one rank, for "Read" or "Write"."""
    if not count:
        yield np.zeros(0)
        return
    matrix, first = ctypes.c_void_p(A.handle), ctypes.POINTER(ctypes.c_double)()
    call(f"MatSeqAIJGetArray{access}", matrix, ctypes.byref(first))
    try:
        yield np.ctypeslib.as_array(first, shape=(count,))
    finally:
        call(f"MatSeqAIJRestoreArray{access}", matrix, ctypes.byref(first))
