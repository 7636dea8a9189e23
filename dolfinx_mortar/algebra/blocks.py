# SPDX-License-Identifier: MIT
"""Matrices of d x d blocks between nodes, at fixed places in the rows of this rank."""

from __future__ import annotations

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from dolfinx import fem
from dolfinx_mortar.arrays import Floats


class BlockMatrix:
    """AIJ matrix in V's layout; the pattern is found per node, not per entry (collective).

    Args:
        V: space with d components per node.
        rows: owned node (p,) of each block, local number.
        columns: node (p,) of each block, global number; places may repeat, values then add up.

    Attributes:
        matrix: the PETSc matrix, zero until ``fill``.
    """

    def __init__(self, V: fem.FunctionSpace, rows: npt.ArrayLike, columns: npt.ArrayLike) -> None:
        """Fix the pattern."""
        layout, d = V.dofmap.index_map, V.dofmap.index_map_bs
        n, N = layout.size_local, layout.size_global
        key = np.asarray(rows, dtype=np.int64) * N + np.asarray(columns, dtype=np.int64)
        order = np.argsort(key, kind="stable")  # fast for keys that are ascending in parts
        ascending = key[order]
        fresh = np.diff(ascending, prepend=-1) > 0
        places = ascending[fresh]
        block = np.empty(len(key), dtype=np.int64)
        block[order] = np.cumsum(fresh) - 1
        self.repeats = len(places) < len(key)
        row, column = np.divmod(places, N)
        count = np.bincount(row, minlength=n)
        before = np.cumsum(count) - count  # blocks in earlier rows of nodes
        component = np.arange(d, dtype=PETSc.IntType)
        self.indptr = np.zeros(d * n + 1, dtype=PETSc.IntType)
        np.cumsum(np.repeat(d * count, d), out=self.indptr[1:])
        # entry (a, b) of a block stands in row a, among the blocks of its node
        place = (d * (np.arange(len(row)) - before[row])).astype(PETSc.IntType)
        starts = self.indptr[d * row[:, None] + component] + place[:, None]
        entries = starts[:, :, None] + component
        self.indices = np.empty(entries.size, dtype=PETSc.IntType)
        self.indices[entries] = (d * column.astype(PETSc.IntType)[:, None] + component)[:, None, :]
        self.entries = entries[block]
        self.values = np.zeros(len(self.indices))
        self.matrix = PETSc.Mat().createAIJ(
            [(d * n, d * N)] * 2, csr=(self.indptr, self.indices, self.values), comm=V.mesh.comm
        )

    def fill(self, blocks: Floats) -> None:
        """Set the matrix to the blocks (p, d, d) (collective)."""
        if self.repeats:
            self.values[:] = 0.0
            np.add.at(self.values, self.entries, blocks)
        else:
            self.values[self.entries] = blocks
        self.matrix.setValuesCSR(self.indptr, self.indices, self.values)
        self.matrix.assemble()
