# SPDX-License-Identifier: MIT
"""Sums of triplets (row, column, value) over all ranks, on a fixed pattern.

PETSc sorts the triplets once and plans the exchange of off-rank rows (MatSetPreallocationCOO, which
petsc4py 3.22 does not wrap); every later sum is one pass over the values. The sum of repeated
entries does not depend on the order of messages.
"""

import ctypes

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from dolfinx_mortar.algebra.blocks import Layout
from dolfinx_mortar.algebra.csr import call, csr_of
from dolfinx_mortar.arrays import Floats, Ints, Longs


class Triplets:
    """Sums at the entries of a square matrix whose rows are divided among ranks (collective).

    Args:
        comm: Communicator.
        layout: How rows and columns are divided among its ranks.
        rows: Global row (t,) of each triplet, of any rank.
        columns: Global column (t,) of each triplet.

    Attributes:
        rows: Owned row (e,) of each entry of this rank, local number; ascending.
        columns: Its global column (e,), ascending within a row.
    """

    rows: Ints
    columns: Longs

    def __init__(
        self, comm: MPI.Intracomm, layout: Layout, rows: npt.ArrayLike, columns: npt.ArrayLike
    ) -> None:
        i, j = (np.array(v, dtype=PETSc.IntType).ravel() for v in (rows, columns))  # PETSc sorts
        assert i.size == j.size
        for indices in (i, j):  # PETSc would write past the end
            inside = (indices >= 0) & (indices < layout.size_global)
            assert inside.all()
        self._sums = PETSc.Mat().create(comm)
        self._sums.setSizes([(layout.size_local, layout.size_global)] * 2)
        self._sums.setType(PETSc.Mat.Type.AIJ)
        pointers = (ctypes.c_void_p(v.ctypes.data) for v in (i, j))
        count = ctypes.c_ssize_t(i.size)
        call("MatSetPreallocationCOO", ctypes.c_void_p(self._sums.handle), count, *pointers)
        self.sum(np.zeros(i.size))
        self._start, found, _ = csr_of(self._sums)
        own = np.arange(layout.size_local, dtype=np.int32)
        self.rows, self.columns = np.repeat(own, np.diff(self._start)), found.astype(np.int64)

    def fill(self, values: npt.ArrayLike) -> PETSc.Mat:
        """Return the matrix of the sums of the values (t,) of the triplets (collective).

        It is the same one in every call, which the next sum refills.
        """
        v = np.ascontiguousarray(values, dtype=PETSc.ScalarType).ravel()
        pointer, mode = ctypes.c_void_p(v.ctypes.data), ctypes.c_int(PETSc.InsertMode.INSERT_VALUES)
        call("MatSetValuesCOO", ctypes.c_void_p(self._sums.handle), pointer, mode)
        return self._sums

    def zero(self) -> PETSc.Mat:
        """Return the matrix of `fill`, whatever its values, for the analysis of its pattern."""
        return self._sums

    def sum(self, values: npt.ArrayLike) -> Floats:
        """Return the sums (e,) of the values (t,) of the triplets (collective)."""
        return csr_of(self.fill(values))[2]

    def matrix(self, values: Floats) -> PETSc.Mat:
        """Return a new matrix with the values (e,) at the entries (collective)."""
        csr = self._start, self.columns.astype(PETSc.IntType), values
        return PETSc.Mat().createAIJ(self._sums.getSizes(), csr=csr, comm=self._sums.comm)
