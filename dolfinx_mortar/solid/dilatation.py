# SPDX-License-Identifier: MIT
r"""Reduced integration of the volumetric part: one dilatation per cell, the mean of the trace.

Where a body keeps its volume, as in plastic flow, the trace at every point is a condition, and
cells of first order have too few unknowns for them: they lock. So laws with the split

    psi(eps) = psi(dev eps) + K/2 tr(eps)^2

get the deviator at the points, and the rest is taken in the mean over each cell,

    psi_vol = K/2 V t^2,    t = (B u - b) / V,    B_a = int tr eps(phi_a),  b = int tr eps_0,

V the volume of the cell, with the weight of the kinematics. Its forces are B^T p with the mean
stress p = K t, which is what is shown; its tangent is the constant matrix B^T (K / V) B. So energy,
forces and tangent belong together, on any shape of cell. (One point at the midpoint is the same on
quadrilaterals in the plane, but misses the patch test on rings and warped hexahedra.)
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import reduce
from operator import add

from petsc4py import PETSc

import numpy as np

import ufl
from dolfinx import fem
from dolfinx.fem import petsc as fem_petsc
from dolfinx_mortar import compat
from dolfinx_mortar.algebra.congruence import as_aij
from dolfinx_mortar.algebra.parallel import any_rank
from dolfinx_mortar.arrays import Floats
from dolfinx_mortar.materials.response import elastic_response
from dolfinx_mortar.solid.eigenstrain import Eigenstrain
from dolfinx_mortar.solid.kinematics import Kinematics, axisymmetric, plane_strain, spatial
from dolfinx_mortar.solid.laws import Region, measure, measures
from dolfinx_mortar.solid.term import assemble, create_vector
from ufl.core.expr import Expr

CELLS = ("quadrilateral", "hexahedron")
# Their trace is linear in u, and the change of volume.
TRACED = (plane_strain, axisymmetric, spatial)


def check_reducible(
    V: fem.FunctionSpace, regions: Sequence[Region], kinematics: Kinematics, degree: int
) -> None:
    """Raise a ValueError where there is no volumetric part that could be reduced."""
    cell, p = V.mesh.topology.cell_name(), V.element.basix_element.degree
    why = "volumetric is 'reduced', which is for"
    if kinematics.finite and cell not in CELLS and p == 1:
        raise ValueError(
            f"{why} quadrilaterals, hexahedra, and simplices of second order, not for {cell}s of "
            f"degree {p}: choose 'full', or such cells"
        )
    if not kinematics.finite and (cell not in CELLS or p != 1):
        raise ValueError(
            f"{why} quadrilaterals and hexahedra of first order, not for {cell}s of degree {p}: "
            "choose 'full', or such cells"
        )
    if kinematics not in TRACED and (kinematics.plane_stress or not kinematics.finite):
        raise ValueError(
            f"{why} the kinematics {', '.join(repr(k.name) for k in TRACED)}, not for "
            f"{kinematics.name!r}: choose 'full'"
        )
    whole = [r.law.name for r in regions if r.law.strain == "finite" and not r.law.volumetric]
    if whole:
        raise ValueError(
            f"{why} laws of F with a part of the volume alone, such as NeoHooke and MooneyRivlin: "
            f"{', '.join(whole)} has no volumetric(J, p); choose 'full'"
        )
    whole = [r.law.name for r in regions if r.law.strain == "small" and not r.law.splits]
    if whole:
        raise ValueError(
            f"{why} laws that split into a deviator and a trace, such as Elastic and VonMises: "
            f"{', '.join(whole)} does not declare splits: ClassVar = True; choose 'full'"
        )
    if degree < 2:
        raise ValueError(
            f"{why} a deviator that is fully integrated, but quadrature_degree is {degree}: give 2 "
            "or more, or None"
        )


class MeanDilatation:
    """The volumetric part of the bodies, in the mean over each cell.

    Attributes:
        mean_stress: p = K t per cell, a DG0 Function; up to date after `follow`.
    """

    def __init__(
        self,
        u: fem.Function,
        regions: Sequence[Region],
        kinematics: Kinematics,
        degree: int,
        eigenstrain: Eigenstrain | None,
    ) -> None:
        """Assemble B and V; collective."""
        V = u.function_space
        Q = fem.functionspace(V.mesh, ("DG", 0))
        self.mean_stress = fem.Function(Q, name="mean_stress")
        self._u, self._vector = u, create_vector(Q)
        dx, parts = measure(V.mesh, degree), measures(V, regions, degree)
        size = kinematics.weight(ufl.SpatialCoordinate(V.mesh)) * ufl.TestFunction(Q)
        trace = ufl.tr(kinematics.virtual(u, ufl.TrialFunction(V)))
        moduli = [
            bulk_modulus_of(region) * size * on for region, on in zip(regions, parts, strict=True)
        ]
        B, volumes, self._modulus = compat.compile_together(
            size * trace * dx, size * dx, reduce(add, moduli)
        )
        self._B = fem_petsc.assemble_matrix(B)
        self._B.assemble()
        self._volumes = assemble(volumes, self._vector).copy()
        free = None if eigenstrain is None else ufl.tr(eigenstrain.tensor) * size * dx
        self._free = None if free is None else fem.form(free)
        self._bulk = np.zeros_like(self._volumes)
        self._tangent: tuple[Floats, PETSc.Mat] | None = None

    def follow(self) -> None:
        """Take over the displacement and the parameters of the laws; collective."""
        self._bulk = assemble(self._modulus, self._vector) / self._volumes
        change = self._change(self._u)
        if self._free is not None:
            change -= assemble(self._free, self._vector)
        self.mean_stress.x.array[: len(change)] = self._bulk * change / self._volumes
        self.mean_stress.x.scatter_forward()

    def _change(self, v: fem.Function) -> Floats:
        """Return B v of the owned cells; collective."""
        return np.asarray((self._B * v.x.petsc_vec).array)

    def energy(self) -> float:
        """Return sum_c K/2 V t^2 = p^2 V / (2 K) over the owned cells, p as `follow` found it."""
        p = self.mean_stress.x.array[: len(self._bulk)]
        return float((p**2 * self._volumes / (2 * self._bulk)).sum())

    def densities(self) -> Floats:
        """Return K/2 t^2 of the owned cells, per volume, as `follow` found t."""
        p = self.mean_stress.x.array[: len(self._bulk)]
        return np.asarray(p**2 / (2 * self._bulk))

    def norm_squared(self, v: fem.Function) -> float:
        """Return sum_c K / V (B v)^2 over the owned cells; collective."""
        return float((self._bulk / self._volumes * self._change(v) ** 2).sum())

    def add_tangent(self, K: PETSc.Mat) -> None:
        """Add B^T (K / V) B to a matrix with the pattern of the mesh; collective.

        It is formed once for given parameters of the laws.
        """
        same = self._tangent is not None and np.array_equal(self._tangent[0], self._bulk)
        if any_rank(self._u.function_space.mesh.comm, not same)[0]:
            self._tangent = None  # before the new one needs the memory
            self._tangent = self._bulk, self._product(K)
        assert self._tangent is not None
        K.axpy(1.0, self._tangent[1], PETSc.Mat.Structure.SAME_NONZERO_PATTERN)

    def _product(self, K: PETSc.Mat) -> PETSc.Mat:
        """Return B^T (K / V) B on the pattern of a matrix K; collective."""
        root, B = self._B.createVecLeft(), self._B.copy()
        root.array[:] = np.sqrt(self._bulk / self._volumes)
        B.diagonalScale(root)
        result = as_aij(K).duplicate(copy=False)
        result.zeroEntries()
        result.assemble()
        square = B.transpose(PETSc.Mat()).matMult(B)
        result.axpy(1.0, square, PETSc.Mat.Structure.SUBSET_NONZERO_PATTERN)
        return result.convert(K.getType())


def bulk_modulus_of(region: Region) -> Expr:
    """Return the bulk modulus of a law in UFL, K = tr(C : I) / 9."""
    return ufl.tr(elastic_response(region.law, ufl.Identity(3), region.symbols)) / 9
