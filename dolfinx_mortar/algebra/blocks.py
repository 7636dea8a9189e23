# SPDX-License-Identifier: MIT
"""Matrices of d x d blocks between nodes, on a fixed pattern."""

from __future__ import annotations

from typing import Protocol

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt
from scipy.sparse import bsr_array

from dolfinx_mortar.algebra.csr import set_csr
from dolfinx_mortar.arrays import Floats


class Layout(Protocol):
    """How nodes are divided among ranks; dolfinx's IndexMap is one."""

    @property
    def size_local(self) -> int:
        """How many nodes this rank owns."""

    @property
    def size_global(self) -> int:
        """How many nodes there are."""


class BlockMatrix:
    """AIJ matrix of d x d blocks; its pattern is that of the blocks (collective).

    Scipy's BSR format sorts the blocks; PETSc's block format has no product with AIJ matrices.

    Args:
        layout: how the nodes are divided among its ranks.
        d: rows and columns of a block.
        rows: owned node (p,) of each block, local number.
        columns: node (p,) of each block, global number; repeated blocks are added.

    Attributes:
        matrix: the PETSc matrix of the last blocks; zero at first.
    """

    def __init__(
        self,
        comm: MPI.Comm,
        layout: Layout,
        d: int,
        rows: npt.ArrayLike,
        columns: npt.ArrayLike,
    ) -> None:
        self._filled: Floats | None = None
        n, N = layout.size_local, layout.size_global
        key = np.asarray(rows, dtype=np.int64) * N + np.asarray(columns, dtype=np.int64)
        order = np.argsort(key, kind="stable")  # fast for keys that are ascending in parts
        ascending = key[order]
        fresh = np.diff(ascending, prepend=-1) > 0
        places = ascending[fresh]
        self._count, self._places = len(places), None
        if len(places) < len(key):  # some are repeated
            self._places = np.empty(len(key), dtype=_smallest_integer(len(key)))
            self._places[order] = np.cumsum(fresh) - 1
            order = np.arange(len(places))
        row, column = np.divmod(places, N)
        start = np.searchsorted(row, np.arange(n + 1))
        numbers = order[:, None] * d**2 + np.arange(d**2)
        numbers = numbers.astype(_smallest_integer(numbers.size))
        numbered = numbers.reshape(-1, d, d), column, start
        csr = bsr_array(numbered, shape=(d * n, d * N)).tocsr()
        self._order = csr.data  # of the entries of all different blocks, row by row
        self.indptr, self.indices = (v.astype(PETSc.IntType) for v in (csr.indptr, csr.indices))
        self.matrix = PETSc.Mat().createAIJ(
            [(d * n, d * N)] * 2,
            csr=(self.indptr, self.indices, np.zeros(len(csr.data))),
            comm=comm,
        )

    def of(self, blocks: Floats) -> PETSc.Mat:
        """Return the matrix of the blocks (p, d, d), refilled unless they are the last array.

        The array must not be changed in place; collective.
        """
        if self._filled is not blocks:
            self.fill(blocks)
        return self.matrix

    def fill(self, blocks: Floats) -> None:
        """Set the matrix to the blocks (p, d, d) (collective)."""
        self._filled = blocks
        values = blocks
        if self._places is not None:
            values = np.zeros((self._count, *blocks.shape[1:]))
            np.add.at(values, self._places, blocks)
        set_csr(self.matrix, self.indptr, self.indices, values.ravel()[self._order])


def _smallest_integer(count: int) -> type[np.signedinteger]:
    """Return the type of numbers up to a count: there are many of them, and they are kept."""
    return np.int32 if count <= np.iinfo(np.int32).max else np.int64
