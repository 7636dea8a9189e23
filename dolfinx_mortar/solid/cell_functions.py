# SPDX-License-Identifier: MIT
"""Functions N of each cell: 1, or (1, x - x_c) for cells of second order, x_c their middle.

Source: D. Boffi, L. Gastaldi, Int. J. Numer. Methods Fluids 39 (2002) 1001-1011.
"""

from __future__ import annotations

from typing import Any

from petsc4py import PETSc

import numpy as np

import ufl
from dolfinx import fem, mesh
from dolfinx.fem import petsc as fem_petsc
from dolfinx_mortar.algebra.congruence import as_aij
from dolfinx_mortar.algebra.csr import csr_of, set_csr
from dolfinx_mortar.common.arrays import Floats
from dolfinx_mortar.solid.term import assemble, create_vector
from ufl.core.expr import Expr


class CellFunctions:
    """The m functions N_k of each cell.

    Attributes:
        space: of coefficients (m,), one block per cell.
        basis: N in UFL.
        volumes: (owned cells,) int 1.
        inverse: (owned cells, m, m), inverse of int N_k N_l.
    """

    def __init__(self, domain: mesh.Mesh, weight: Expr, dx: ufl.Measure, *, affine: bool) -> None:
        """Integrate over `dx`, with the coordinates if `affine`; collective."""
        m = 1 + domain.geometry.dim * affine
        self.space = fem.functionspace(domain, ("DG", 0, (m,)))
        self.basis = ufl.as_vector([1.0])
        if affine:
            d, place = domain.topology.dim, fem.Function(self.space)
            layout = domain.topology.index_map(d)
            cells = np.arange(layout.size_local + layout.num_ghosts, dtype=np.int32)
            values = place.x.array.reshape(-1, m)
            at = self.space.dofmap.list[cells, 0]
            values[at, 0] = domain.h(d, cells)
            values[at, 1:] = mesh.compute_midpoints(domain, d, cells)[:, : m - 1]
            offset = ufl.SpatialCoordinate(domain) - ufl.as_vector([place[i] for i in range(1, m)])
            self.basis = ufl.as_vector([1.0, *(offset[i] / place[0] for i in range(m - 1))])
        products = fem.functionspace(domain, ("DG", 0, (m, m)))
        self._tests = ufl.TestFunction(self.space), ufl.TestFunction(products)
        self._vectors = create_vector(self.space), create_vector(products)
        mass = self.matrices(fem.form(self.paired(ufl.as_ufl(1.0)) * weight * dx))
        self.volumes = mass[:, 0, 0].copy()
        self.inverse = np.linalg.inv(mass).astype(np.float64)

    @property
    def size(self) -> int:
        """The number m of functions."""
        return int(self.space.dofmap.bs)

    def field(self, coefficients: fem.Function) -> Expr:
        """Return sum_k c_k N_k."""
        return ufl.dot(coefficients, self.basis)

    def tested(self, density: Expr) -> Expr:
        """Form of `vectors`: int density N_k, N_0 = 1."""
        return density * ufl.dot(self._tests[0], self.basis)

    def paired(self, density: Expr) -> Expr:
        """Form of `matrices`: int density N_k N_l."""
        return density * ufl.inner(ufl.outer(self.basis, self.basis), self._tests[1])

    def vectors(self, form: fem.Form) -> Floats:
        """Integrals (owned cells, m); collective."""
        return assemble(form, self._vectors[0]).reshape(-1, self.size).copy()

    def matrices(self, form: fem.Form) -> Floats:
        """Integrals (owned cells, m, m); collective."""
        return assemble(form, self._vectors[1]).reshape(-1, self.size, self.size).copy()

    def coefficients(self, integrals: Floats) -> Floats:
        """Coefficients (owned cells, m) of the projection, given its integrals with N_k."""
        return np.asarray(np.einsum("ckl,cl->ck", self.inverse, integrals))

    def values(self, f: fem.Function) -> Floats:
        """View of the coefficients (owned cells, m)."""
        return np.asarray(f.x.array[: self.inverse[:, 0].size].reshape(-1, self.size))


class RowsOfCells:
    """A matrix B with m rows per cell, and B^T W B with blocks W."""

    def __init__(self, form: Any, m: int) -> None:
        """Create the matrix without entries; collective."""
        self._form, self._m = form, m
        self._B = fem_petsc.create_matrix(form)
        self._products: tuple[PETSc.Mat, PETSc.Mat, PETSc.Mat] | None = None
        self._sums: tuple[PETSc.Mat, PETSc.Mat] | None = None

    def assemble(self) -> None:
        """Assemble B; collective."""
        self._B.zeroEntries()
        fem_petsc.assemble_matrix(self._B, self._form)
        self._B.assemble()

    def times(self, v: fem.Function) -> Floats:
        """Return B v (owned cells, m); collective."""
        return np.asarray((self._B * v.x.petsc_vec).array).reshape(-1, self._m)

    def add_square(self, weights: Floats, K: PETSc.Mat) -> None:
        """Add B^T W B, W (owned cells, m, m), to a matrix of the mesh; collective."""
        indptr, columns, values = csr_of(self._B)
        rows = len(weights), self._m  # rows of a cell have the same columns
        blocks = values.reshape(*rows, len(values) // max(rows[0] * rows[1], 1))
        if self._products is None:
            weighted, transpose = self._B.duplicate(copy=True), self._B.transpose(PETSc.Mat())
            self._products = weighted, transpose, transpose.matMult(weighted)
        weighted, transpose, product = self._products
        set_csr(weighted, indptr, columns, (weights @ blocks).ravel())
        self._B.transpose(transpose)
        transpose.matMult(weighted, result=product)
        subset = PETSc.Mat.Structure.SUBSET_NONZERO_PATTERN
        if "baij" not in K.getType():
            K.axpy(1.0, product, subset)
            return
        if self._sums is None:  # blocks have the whole pattern, a product only its entries
            total = as_aij(K).duplicate(copy=False)
            self._sums = total, total.convert(K.getType(), out=PETSc.Mat())
        total, in_blocks = self._sums
        total.zeroEntries()
        total.axpy(1.0, product, subset)
        total.convert(K.getType(), out=in_blocks)
        K.axpy(1.0, in_blocks, PETSc.Mat.Structure.SAME_NONZERO_PATTERN)
