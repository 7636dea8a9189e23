# SPDX-License-Identifier: MIT
"""Reduced integration of the volumetric part: one mean volume change for each cell.

**Small strain**, psi(eps) = psi(dev eps) + K/2 tr(eps)^2: the laws get the deviator, and

    psi_vol = K/2 V t^2,    t = (B u - b) / V,    B_a = int tr eps(phi_a),  b = int tr eps_0,

V the volume of the cell, with the weight of the kinematics. The forces are B^T p with the mean
stress p = K t of the output, the tangent is B^T (K / V) B. **Finite strain**, psi(F) = psi_0(F) +
U(J), with p as an unknown: theory.md, Finite strain. On triangles and tetrahedra of second order N
would lock. The mean is a projection onto the functions N of each cell: 1, or (1, x - x_c) for
cells of second order, x_c their middle. Pressures of tetrahedra, and of hexahedra of first order,
alternate.

Sources: Simo, Taylor, Pister, Comput. Methods Appl. Mech. Engrg. 51 (1985) 177-208; T. Sussman,
K.-J. Bathe, Comput. Struct. 26 (1987) 357-409 (9/3); D. Boffi, L. Gastaldi, Int. J. Numer. Methods
Fluids 39 (2002) 1001-1011 (N).
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

from petsc4py import PETSc

import numpy as np

import ufl
from dolfinx import default_scalar_type, fem, mesh
from dolfinx.fem import petsc as fem_petsc
from dolfinx_mortar.algebra.congruence import as_aij
from dolfinx_mortar.algebra.csr import csr_of, set_csr
from dolfinx_mortar.algebra.parallel import any_rank
from dolfinx_mortar.common.arguments import check, one_of
from dolfinx_mortar.common.arrays import Floats
from dolfinx_mortar.common.spaces import set_owned
from dolfinx_mortar.materials.response import Response, elastic_response, without_variables
from dolfinx_mortar.solid.kinematics import axisymmetric, plane_strain, spatial
from dolfinx_mortar.solid.laws import Eigenstrain, Integral, Region, measure
from dolfinx_mortar.solid.term import assemble, create_vector
from ufl.algorithms import expand_derivatives
from ufl.classes import Label, Variable
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
        return np.einsum("ckl,cl->ck", self.inverse, integrals)

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


CELLS = ("quadrilateral", "hexahedron")
# Their trace is linear in u.
TRACED = (plane_strain, axisymmetric, spatial)


def create_dilatation(
    u: fem.Function,
    given: Any,
    integral: Integral,
    elastic: Expr,
    eigenstrain: Eigenstrain | None,
) -> MeanVolume | None:
    """Volumetric part in the mean, None for "full"; a ValueError for other choices; collective."""
    if check("volumetric", given, one_of("full", "reduced")) == "full":
        return None
    kinematics = integral.kinematics
    V, regions, degree = u.function_space, integral.regions, integral.degree
    cell, p = V.mesh.topology.cell_name(), V.element.basix_element.degree
    laws = [r.law for r in regions]
    whole = ", ".join(k.name for k in laws if k.strain == "finite" and not k.volumetric)
    unsplit = ", ".join(k.name for k in laws if k.strain == "small" and not k.splits)
    finite, first = kinematics.finite, p == 1
    flat = kinematics.plane_stress or not finite
    rules = {
        "quadrilaterals, hexahedra, and simplices of second order, "
        f"not for {cell}s of degree {p}": not finite or cell in CELLS or not first,
        f"quadrilaterals and hexahedra of first order, not for {cell}s of degree {p}": finite
        or (cell in CELLS and first),
        f"the kinematics {', '.join(repr(k.name) for k in TRACED)}, "
        f"not for {kinematics.name!r}": kinematics in TRACED or not flat,
        "laws of F with a part of the volume alone, such as NeoHooke and MooneyRivlin: "
        f"{whole} has no volumetric(J, p)": not whole,
        "laws that split into a deviator and a trace, such as Elastic and VonMises: "
        f"{unsplit} does not declare splits: ClassVar = True": not unsplit,
        "a deviator that is fully integrated, "
        f"but quadrature_degree is {degree}: give 2 or more, or None, or": degree >= 2,
    }
    for rule, holds in rules.items():
        if not holds:
            raise ValueError(f"volumetric is 'reduced', which is for {rule}: choose 'full'")
    return MeanVolume(u, integral, elastic, eigenstrain)


def bulk_modulus_of(region: Region) -> Expr:
    """K = tr(C : I) / 9 of a law in UFL."""
    return ufl.tr(elastic_response(region.law, ufl.Identity(3), region.symbols)) / 9


@dataclass(frozen=True)
class VolumeStep:
    """Volumes and pressures along a step u + t du, linearised at u."""

    ratio: Floats  # (owned cells, m) coefficients of j at u
    change: Floats  # (owned cells, m) of its derivative along du
    energy: Floats  # (owned cells,) int U(j)
    slope: Floats  # (owned cells, m) int U'(j) N_k
    stiffness: Floats  # (owned cells, m, m) int U''(j) N_k N_l
    inverse: Floats  # (owned cells, m, m), of int N_k N_l

    def slope_at(self, t: float) -> Floats:
        """Integrals (owned cells, m) of p + t U'' dj times N_k."""
        return self.slope + t * np.einsum("ckl,cl->ck", self.stiffness, self.change)

    def pressure_at(self, t: float) -> Floats:
        """Coefficients (owned cells, m) of p + t U'' dj."""
        return np.einsum("ckl,cl->ck", self.inverse, self.slope_at(t))

    def energy_at(self, t: float, ratio: Floats) -> Floats:
        """Energy of each cell at another j, linear about the linearisation."""
        way, slope = t * self.change, self.slope_at(t)
        along = ((self.slope + slope) / 2 * way).sum(axis=1)
        missed = (slope * (ratio - self.ratio - way)).sum(axis=1)
        return self.energy + along + missed


class MeanVolume:
    """The volumetric part, by the mean of j over each cell: tr eps, at finite strain J.

    Attributes:
        cells: the functions onto which j and U'(j) are projected.
        mean_stress: coefficients of p, as of `follow`.
    """

    def __init__(
        self, u: fem.Function, integral: Integral, elastic: Expr, eigenstrain: Eigenstrain | None
    ) -> None:
        """Compile, for a strain without the eigenstrain; collective."""
        V, regions, self._finite = u.function_space, integral.regions, integral.kinematics.finite
        dx = measure(V.mesh, integral.degree)
        second = V.element.basix_element.degree > 1 and V.mesh.topology.cell_name() in CELLS
        affine = self._finite and second
        self.cells = cells = CellFunctions(V.mesh, integral.weight, dx, affine=affine)
        self.mean_stress, self._ratio = (fem.Function(cells.space) for _ in range(2))
        self._ratio.x.array[:: cells.size] = 1.0 * self._finite
        self._at = fem.Constant(V.mesh, default_scalar_type(1.0))  # j, for derivatives
        self._gradient, growth = elastic, ufl.as_ufl(1.0)
        if self._finite and eigenstrain is not None:
            growth = ufl.det(eigenstrain.growth)
        self._pressure = self.cells.field(self.mean_stress) / growth
        of_point = ufl.det(self._gradient) if self._finite else ufl.tr(self._gradient)
        change = ufl.derivative(of_point, u, ufl.TrialFunction(V))
        j = cells.field(self._ratio)
        energy, slope, stiffness = (
            [growth * self._slope(r, k, j) for r in regions] for k in range(3)
        )
        B, self._volume_form, self._bulk_form, *self._energy_forms = fem.form(
            [
                cells.tested(change) * integral.weight * dx,
                cells.tested(of_point) * integral.weight * dx,
                integral(cells.paired(bulk_modulus_of(r)) for r in regions),
                integral(map(cells.tested, energy)),
                integral(map(cells.tested, slope)),
                integral(map(cells.paired, stiffness)),
            ]
        )
        self._B = RowsOfCells(B, cells.size)
        self._B.assemble()
        self._tangent: tuple[Floats, PETSc.Mat] | None = None  # of small strain, and its weights

    def _slope(self, region: Region, order: int, J: Expr) -> Expr:
        at = Variable(self._at, Label(-4))
        value = self._energy_of(region, at)
        for _ in range(order):
            value = ufl.diff(value, at)
        return ufl.replace(without_variables(expand_derivatives(value)), {self._at: J})

    def complete(self, region: Region, response: Response) -> Response:
        """Response with p in place of U'(J), and without U(J) in the energy.

        At small strain that of the deviator, which has neither.
        """
        F, p = self._gradient, self._pressure
        if not self._finite:
            return dataclasses.replace(
                response,
                stress=response.stress + p * ufl.Identity(3),
                change=lambda direction: response.change(ufl.dev(direction)),
            )

        def stress(gradient: Expr) -> Expr:
            J = ufl.det(gradient)
            return (p - self._slope(region, 1, J)) * J * ufl.transpose(ufl.inv(gradient))

        def change(direction: Expr) -> Expr:
            step = Variable(ufl.as_ufl(0.0), Label(-5))
            slope = ufl.diff(stress(F + step * direction), step)
            return response.change(direction) + without_variables(expand_derivatives(slope))

        energy = response.energy
        energy = None if energy is None else energy - self._energy_of(region, ufl.det(F))
        total = response.stress + stress(F)
        return dataclasses.replace(response, stress=total, energy=energy, change=change)

    def follow(self) -> None:
        """Update to displacement and parameters; collective."""
        cells = self.cells
        set_owned(self._ratio, cells.coefficients(cells.vectors(self._volume_form)))
        self.set_pressure(cells.coefficients(cells.vectors(self._energy_forms[1])))

    def set_pressure(self, pressure: Floats) -> None:
        """Set the coefficients (owned cells, m) of p until the next `follow`; collective."""
        set_owned(self.mean_stress, pressure)

    def energy(self, along: tuple[VolumeStep, float] | None = None) -> float:
        """Return sum_c int U(j) over the owned cells as of `follow`, or along a step."""
        if along is None:
            return float(self._energies().sum())
        step, t = along
        return float(step.energy_at(t, self.cells.values(self._ratio)).sum())

    def _energies(self) -> Floats:
        return self.cells.vectors(self._energy_forms[0])[:, 0]

    def densities(self) -> Floats:
        """Mean of U(j) over each owned cell, per volume at X."""
        return self._energies() / self.cells.volumes

    def step_along(self, v: fem.Function) -> VolumeStep:
        """Volumes and pressures along a step v from the present u; collective."""
        self.follow()
        cells = self.cells
        return VolumeStep(
            ratio=cells.values(self._ratio).copy(),
            change=cells.coefficients(self._change(v)),
            energy=self._energies(),
            slope=cells.vectors(self._energy_forms[1]),
            stiffness=cells.matrices(self._energy_forms[2]),
            inverse=cells.inverse,
        )

    def _change(self, v: fem.Function) -> Floats:
        """Return B v (owned cells, m); collective."""
        if self._finite:
            self._B.assemble()
        return self._B.times(v)

    def norm_squared(self, v: fem.Function) -> float:
        """Return sum_c int K (B v / V)^2 over the owned cells, K at small strain."""
        change = self.cells.coefficients(self._change(v))
        bulk = self.cells.matrices(self._bulk_form)
        return float(np.einsum("ck,ckl,cl->", change, bulk, change))

    def add_tangent(self, K: PETSc.Mat) -> None:
        """Add B^T (U''(j) / V) B to a matrix with the pattern of the mesh; collective."""
        inverse, stiffness = self.cells.inverse, self.cells.matrices(self._energy_forms[2])
        weights = inverse @ stiffness @ inverse
        if self._finite:
            self._B.assemble()
            self._B.add_square(weights, K)
            return
        same = self._tangent is not None and np.array_equal(self._tangent[0], weights)
        if any_rank(self._ratio.function_space.mesh.comm, not same)[0]:
            self._tangent = None  # free the memory first
            product = K.duplicate(copy=False)
            product.zeroEntries()
            product.assemble()
            self._B.add_square(weights, product)
            self._tangent = weights, product
        assert self._tangent is not None
        K.axpy(1.0, self._tangent[1], PETSc.Mat.Structure.SAME_NONZERO_PATTERN)

    def _energy_of(self, region: Region, j: Expr) -> Expr:
        """U(j) of a law of F; of a law that splits K/2 (ln j)^2, at small strain K/2 j^2."""
        if region.law.strain == "finite":
            assert region.law.volumetric is not None
            return region.law.volumetric(j, region.symbols)
        return bulk_modulus_of(region) / 2 * (ufl.ln(j) if self._finite else j) ** 2
