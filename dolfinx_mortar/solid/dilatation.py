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
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

import basix
import ufl
from dolfinx import default_scalar_type, fem
from dolfinx_mortar.arrays import Floats, Ints
from dolfinx_mortar.materials.response import elastic_response
from dolfinx_mortar.solid.eigenstrain import Eigenstrain
from dolfinx_mortar.solid.kinematics import Kinematics, axisymmetric, plane_strain, spatial
from dolfinx_mortar.solid.laws import Region

CELLS = ("quadrilateral", "hexahedron")
VOLUMETRIC = ("full", "reduced")
# Their trace is linear in u, and the change of volume.
TRACED = (plane_strain, axisymmetric, spatial)
# Cells whose shape functions are tabulated at a time: 40 MB of hexahedra.
_CHUNK = 2**15


def create_dilatation(
    u: fem.Function,
    given: Any,
    regions: Sequence[Region],
    kinematics: Kinematics,
    degree: int,
    *,
    eigenstrain: Eigenstrain | None,
) -> MeanDilatation | None:
    """Return what takes the volumetric part in the mean, None for "full"; collective.

    Args:
        u: displacement.
        given: "full" or "reduced".
        regions: laws on cells.
        kinematics: measure and weight.
        degree: of the quadrature.
        eigenstrain: what the laws do not see, if there is any.

    Raises:
        ValueError: for an unknown choice, and where there is nothing that could be reduced.
    """
    if not isinstance(given, str) or given not in VOLUMETRIC:
        raise ValueError(f"volumetric is {given!r}: choose 'full' or 'reduced'")
    if given == "full":
        return None
    _check_reducible(u.function_space, regions, kinematics, degree)
    return MeanDilatation(u, regions, kinematics, degree, eigenstrain)


def _check_reducible(
    V: fem.FunctionSpace, regions: Sequence[Region], kinematics: Kinematics, degree: int
) -> None:
    """Raise a ValueError where there is no volumetric part that could be reduced."""
    cell, p = V.mesh.topology.cell_name(), V.element.basix_element.degree
    why = "volumetric is 'reduced', which is for"
    if cell not in CELLS or p != 1:
        raise ValueError(
            f"{why} quadrilaterals and hexahedra of first order, not for {cell}s of degree {p}: "
            "choose 'full', or such cells"
        )
    if kinematics not in TRACED:
        raise ValueError(
            f"{why} the kinematics {', '.join(repr(k.name) for k in TRACED)}, not for "
            f"{kinematics.name!r}: choose 'full'"
        )
    whole = [region.law.name for region in regions if not region.law.splits]
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


@dataclass(frozen=True)
class Cells:
    """The dilatations of the local cells, ghosts included, as functions of their unknowns."""

    dofs: Ints  # (m, n) local unknowns
    B: Floats  # (m, n) int tr eps(phi_a)
    weights: Floats  # (m, q) of the integration points
    owned: int

    @cached_property
    def volumes(self) -> Floats:
        """The volumes (m,), with the weight of the kinematics."""
        return np.asarray(self.weights.sum(axis=1))


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
        """Tabulate the cells; collective."""
        domain = u.function_space.mesh
        self.mean_stress = fem.Function(fem.functionspace(domain, ("DG", 0)), name="mean_stress")
        points, _ = map(np.asarray, basix.make_quadrature(domain.basix_cell(), degree))
        self._u, self._eigenstrain = u, eigenstrain
        self._cells = _tabulate(u, kinematics, degree)
        self._laws = [(r.cells, _bulk_modulus(r, u, points)) for r in regions]
        self._tables = [r.parameters.function for r in regions]
        self._moduli: Floats | None = None
        self._seen: list[Floats] = []
        self._tangent: tuple[Floats, PETSc.Mat] | None = None

    def follow(self) -> None:
        """Take over the displacement and the parameters of the laws; without communication."""
        cells, bulk = self._cells, self._bulk()
        change = np.einsum("ca,ca->c", cells.B, self._u.x.array[cells.dofs])
        if self._eigenstrain is not None:
            traces = self._eigenstrain.traces()[: len(change)]
            change -= np.einsum("cq,cq->c", cells.weights, traces)
        dofs = self.mean_stress.function_space.dofmap.list[: len(change), 0]
        self.mean_stress.x.array[dofs] = bulk * change / cells.volumes

    def energy(self) -> float:
        """Return sum_c K/2 V t^2 = p^2 V / (2 K) over the owned cells, p as `follow` found it."""
        dofs, own = self.mean_stress.function_space.dofmap.list, slice(None, self._cells.owned)
        p = self.mean_stress.x.array[dofs[own, 0]]
        return float((p**2 * self._cells.volumes[own] / (2 * self._bulk()[own])).sum())

    def norm_squared(self, v: fem.Function) -> float:
        """Return sum_c K / V (B v)^2 over the owned cells."""
        cells, own = self._cells, slice(None, self._cells.owned)
        change = (cells.B[own] * v.x.array[cells.dofs[own]]).sum(axis=1)
        return float((self._bulk()[own] / cells.volumes[own] * change**2).sum())

    def add_tangent(self, K: PETSc.Mat) -> None:
        """Add B^T (K / V) B to a matrix with the pattern of the mesh; collective.

        It is formed once for given parameters of the laws.
        """
        comm, bulk = self._u.function_space.mesh.comm, self._bulk()
        same = self._tangent is not None and np.array_equal(self._tangent[0], bulk)
        if comm.allreduce(not same, op=MPI.LOR):
            self._tangent = None  # before the new one needs the memory
            self._tangent = bulk, _product(self._u.function_space, self._cells, bulk, K)
        assert self._tangent is not None
        K.axpy(1.0, self._tangent[1], PETSc.Mat.Structure.SAME_NONZERO_PATTERN)

    def _bulk(self) -> Floats:
        """Return the mean bulk modulus (m,) of the local cells, for the parameters as they are."""
        now = [table.x.array for table in self._tables]
        if self._moduli is None or not all(map(np.array_equal, now, self._seen)):
            self._moduli, self._seen = self._mean_bulk(), [values.copy() for values in now]
        return self._moduli

    def _mean_bulk(self) -> Floats:
        """Evaluate the mean bulk modulus (m,) of the local cells."""
        weights = self._cells.weights
        bulk = np.zeros(len(weights))
        for cells, expression in self._laws:
            values = expression.eval(self._u.function_space.mesh, cells)
            values = np.asarray(values).reshape(len(cells), weights.shape[1])
            w = weights[cells]
            bulk[cells] = (w * values).sum(axis=1) / w.sum(axis=1)
        return bulk


def _bulk_modulus(region: Region, u: fem.Function, points: Floats) -> fem.Expression:
    """Compile the bulk modulus of a law, K = tr(C : I) / 9; collective."""
    zero = fem.Constant(u.function_space.mesh, default_scalar_type(0.0))
    stress = elastic_response(region.law, ufl.Identity(3) + zero * ufl.Identity(3), region.symbols)
    return fem.Expression(ufl.tr(stress) / 9 + zero, points)


def _tabulate(u: fem.Function, kinematics: Kinematics, degree: int) -> Cells:
    """Integrate the traces of the shape functions over the local cells; collective."""
    V = u.function_space
    domain, bs = V.mesh, V.dofmap.bs
    points, weights = map(np.asarray, basix.make_quadrature(domain.basix_cell(), degree))
    x = ufl.SpatialCoordinate(domain)
    size = kinematics.weight(x) * abs(ufl.JacobianDeterminant(domain))
    zero = fem.Constant(domain, default_scalar_type(0.0))
    volume = fem.Expression(size + zero, points)
    trace = fem.Expression(ufl.tr(kinematics.virtual(u, ufl.TestFunction(V))), points)
    imap = domain.topology.index_map(domain.topology.dim)
    count, nodes = imap.size_local + imap.num_ghosts, V.dofmap.list
    dofs = (bs * nodes[:count, :, None] + np.arange(bs)).reshape(count, -1).astype(np.int32)
    w, B = np.zeros((count, len(weights))), np.zeros(dofs.shape)
    for first in range(0, count, _CHUNK):
        cells = np.arange(first, min(first + _CHUNK, count), dtype=np.int32)
        part = slice(first, first + len(cells))
        w[part] = np.asarray(volume.eval(domain, cells)).reshape(len(cells), -1) * weights
        at_points = np.asarray(trace.eval(domain, cells)).reshape(len(cells), len(weights), -1)
        B[part] = np.einsum("cq,cqa->ca", w[part], at_points)
    return Cells(dofs, B, w, imap.size_local)


def _product(V: fem.FunctionSpace, cells: Cells, bulk: Floats, K: PETSc.Mat) -> PETSc.Mat:
    """Return B^T (K / V) B on the pattern of a matrix K; collective."""
    own, bs = slice(None, cells.owned), V.dofmap.index_map_bs
    imap = V.dofmap.index_map
    nodes = imap.local_to_global((cells.dofs[own] // bs).ravel().astype(np.int32))
    columns = bs * nodes + cells.dofs[own].ravel() % bs
    root = np.sqrt(bulk[own] / cells.volumes[own])[:, None]
    start = np.arange(cells.owned + 1) * cells.dofs.shape[1]
    csr = (
        start.astype(PETSc.IntType),
        columns.astype(PETSc.IntType),
        (root * cells.B[own]).ravel(),
    )
    sizes = ((cells.owned, None), (bs * imap.size_local, bs * imap.size_global))
    B = PETSc.Mat().createAIJ(sizes, csr=csr, comm=V.mesh.comm)
    product = B.transposeMatMult(B)
    result = K.duplicate(copy=False)
    result.zeroEntries()
    result.assemble()
    result.axpy(1.0, product, PETSc.Mat.Structure.SUBSET_NONZERO_PATTERN)
    return result
