# SPDX-License-Identifier: MIT
r"""Mean dilatation at finite strain: the mean of J = det F over each cell.

Where a body keeps its volume, J = 1 at every point is too many conditions: cells of first order
lock. So of laws whose energy has a part of the volume alone,

    psi(F) = psi_0(F) + U(J),

that part is taken in the mean over each cell,

    psi_vol = V U(j),    j = 1/V int J dX,

V the volume of the cell at X, with the weight of the kinematics. Its forces are p B^T with the mean
stress p = U'(j) and B_a = int dJ/du_a dX; its tangent is p d2J/du2, a part of the forms, and B^T
(U''(j) / V) B. So energy, forces and tangent belong together.

On quadrilaterals and hexahedra of second order the mean is the projection onto N = (1, x - x_c),
see `cell_functions`: with M = int N N^T, B_ka = int N_k dJ/du_a, S = int U''(j) N N^T

    psi_vol = int U(j),  j = N^T M^-1 int N J,  p = N^T M^-1 int N U'(j),  B^T M^-1 S M^-1 B.

Triangles and tetrahedra of second order have constants: with N they would have one pressure for
each two displacements, which locks. (Smallest singular values of B, in the norms of strains and
pressures: constants on triangles .53 on any mesh; linear ones 0. Constants on tetrahedra cut out of
cubes fall with h, .40 to .20 with 2 to 5 cubes along an edge, so that pressures alternate; those of
hexahedra of first order do, too.)

Where U'' is far above the other moduli, Newton's method on u alone takes many short steps: after
one that changes shears by e, j is wrong by e^2, and p by U'' e^2, which makes the next tangent
indefinite and the energy larger. If p is an unknown beside u, a step leaves it where its
linearisation goes,

    p + U''(j) B du / V,

and its forces are those of U'(j(u)) at the next iterate all the same. Only p d2J/du2 of the next
tangent has the p of the linearisation, and the energy along a step its volumes (`VolumeStep`). At
the solution both p are the same, and the rate stays quadratic.

Sources: Simo, Taylor, Pister, Comput. Methods Appl. Mech. Engrg. 51 (1985) 177-208, with constant
pressure and dilatation in each cell; T. Sussman, K.-J. Bathe, Comput. Struct. 26 (1987) 357-409,
linear ones with displacements of second order (their 9/3); for p as an unknown D. Magisano, L.
Leonetti, G. Garcea, Comput. Methods Appl. Mech. Engrg. 313 (2017) 986-1005, who treat all stresses
so.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from operator import add
from typing import Any

from petsc4py import PETSc

import numpy as np

import ufl
from dolfinx import default_scalar_type, fem
from dolfinx_mortar import compat
from dolfinx_mortar.arguments import check, one_of
from dolfinx_mortar.arrays import Floats
from dolfinx_mortar.materials.response import Response, without_variables
from dolfinx_mortar.solid.cell_functions import CellFunctions, RowsOfCells
from dolfinx_mortar.solid.dilatation import CELLS, MeanDilatation, bulk_modulus_of, check_reducible
from dolfinx_mortar.solid.eigenstrain import Eigenstrain
from dolfinx_mortar.solid.kinematics import Kinematics
from dolfinx_mortar.solid.laws import Region, measure, measures
from dolfinx_mortar.spaces import set_owned
from ufl.algorithms import expand_derivatives
from ufl.classes import Label, Variable
from ufl.core.expr import Expr


def create_dilatation(
    u: fem.Function,
    given: Any,
    regions: Sequence[Region],
    kinematics: Kinematics,
    degree: int,
    *,
    eigenstrain: Eigenstrain | None,
) -> MeanDilatation | MeanVolume | None:
    """Return what takes the volumetric part in the mean, None for "full"; collective.

    Raises:
        ValueError: for another choice than "full" and "reduced", and where nothing can be reduced.
    """
    if check("volumetric", given, one_of("full", "reduced")) == "full":
        return None
    check_reducible(u.function_space, regions, kinematics, degree)
    if kinematics.finite:
        return MeanVolume(u, regions, kinematics, degree)
    return MeanDilatation(u, regions, kinematics, degree, eigenstrain)


@dataclass(frozen=True)
class VolumeStep:
    """Volumes and pressures along a step u + t du, as linearised at u; N as in `cell_functions`."""

    ratio: Floats  # (owned cells, m) coefficients of j at u
    change: Floats  # (owned cells, m) those of its derivative along du
    energy: Floats  # (owned cells,) int U(j)
    slope: Floats  # (owned cells, m) int U'(j) N_k
    stiffness: Floats  # (owned cells, m, m) int U''(j) N_k N_l
    inverse: Floats  # (owned cells, m, m) that of int N_k N_l

    def slope_at(self, t: float) -> Floats:
        """Return the integrals (owned cells, m) of p + t U'' dj times N_k."""
        return self.slope + t * np.einsum("ckl,cl->ck", self.stiffness, self.change)

    def pressure_at(self, t: float) -> Floats:
        """Return the coefficients (owned cells, m) of p + t U'' dj."""
        return np.asarray(np.einsum("ckl,cl->ck", self.inverse, self.slope_at(t)))

    def energy_at(self, t: float, ratio: Floats) -> Floats:
        """Return the energy of each cell at another j, linear in what the linearisation misses.

        It is below int U(j), if that is convex, by U''/2 times the square of what is missed.
        """
        way, slope = t * self.change, self.slope_at(t)
        along = ((self.slope + slope) / 2 * way).sum(axis=1)
        missed = (slope * (ratio - self.ratio - way)).sum(axis=1)
        return np.asarray(self.energy + along + missed)


class MeanVolume:
    """The part of the energy that depends on the volume, by the mean of J over each cell.

    Attributes:
        cells: the functions of a cell onto which J and U'(j) are projected.
        mean_stress: coefficients of p, the projection of U'(j); up to date after `follow`.
    """

    def __init__(
        self, u: fem.Function, regions: Sequence[Region], kinematics: Kinematics, degree: int
    ) -> None:
        """Compile; collective."""
        V = u.function_space
        size = kinematics.weight(ufl.SpatialCoordinate(V.mesh))
        dx, parts = measure(V.mesh, degree), measures(V, regions, degree)
        affine = V.element.basix_element.degree > 1 and V.mesh.topology.cell_name() in CELLS
        self.cells = cells = CellFunctions(V.mesh, size, dx, affine=affine)
        self.mean_stress, self._ratio = (fem.Function(cells.space) for _ in range(2))
        self._ratio.x.array[:: cells.size] = 1.0
        self._at = fem.Constant(V.mesh, default_scalar_type(1.0))  # stands for J in derivatives
        self._gradient = kinematics.measure(u)
        J = ufl.det(self._gradient)
        change = ufl.derivative(J, u, ufl.TrialFunction(V))
        j = cells.field(self._ratio)

        def summed(densities: Sequence[Expr]) -> ufl.Form:
            pairs = zip(densities, parts, strict=True)
            return reduce(add, (density * size * on for density, on in pairs))

        energy, slope, stiffness = ([self._slope(r, k, j) for r in regions] for k in range(3))
        B, self._volume_form, self._bulk_form, *self._energy_forms = compat.compile_together(
            cells.tested(change) * size * dx,
            cells.tested(J) * size * dx,
            summed([cells.paired(bulk_modulus_of(r)) for r in regions]),
            summed([cells.first(e) for e in energy]),
            summed([cells.tested(e) for e in slope]),
            summed([cells.paired(e) for e in stiffness]),
        )
        self._B = RowsOfCells(B, cells.size)

    def _slope(self, region: Region, order: int, J: Expr) -> Expr:
        """Return a derivative of U at J."""
        at = Variable(self._at, Label(-4))
        value = volumetric_energy(region, at)
        for _ in range(order):
            value = ufl.diff(value, at)
        return ufl.replace(without_variables(expand_derivatives(value)), {self._at: J})

    def complete(self, region: Region, response: Response) -> Response:
        """Return a response with p in place of U'(J), and without U(J) in the energy."""
        F, p = self._gradient, self.cells.field(self.mean_stress)

        def stress(gradient: Expr) -> Expr:
            J = ufl.det(gradient)
            return (p - self._slope(region, 1, J)) * J * ufl.transpose(ufl.inv(gradient))

        def change(direction: Expr) -> Expr:
            step = Variable(ufl.as_ufl(0.0), Label(-5))
            slope = ufl.diff(stress(F + step * direction), step)
            return response.change(direction) + without_variables(expand_derivatives(slope))

        energy = response.energy
        energy = None if energy is None else energy - volumetric_energy(region, ufl.det(F))
        total = response.stress + stress(F)
        return dataclasses.replace(response, stress=total, energy=energy, change=change)

    def follow(self) -> None:
        """Take over the displacement and the parameters of the laws; collective."""
        cells = self.cells
        set_owned(self._ratio, cells.coefficients(cells.vectors(self._volume_form)))
        self.set_pressure(cells.coefficients(cells.vectors(self._energy_forms[1])))

    def set_pressure(self, pressure: Floats) -> None:
        """Let p have coefficients (owned cells, m), until the next `follow`; collective."""
        set_owned(self.mean_stress, pressure)

    def energy(self, along: tuple[VolumeStep, float] | None = None) -> float:
        """Return sum_c int U(j) over the owned cells, as `follow` found j.

        Along a step, at the length t, `VolumeStep.energy_at`.
        """
        if along is None:
            return float(self._energies().sum())
        step, t = along
        return float(step.energy_at(t, self.cells.values(self._ratio)).sum())

    def _energies(self) -> Floats:
        """Return int U(j) of the owned cells; collective."""
        return self.cells.vectors(self._energy_forms[0])[:, 0]

    def densities(self) -> Floats:
        """Return the mean of U(j) over each owned cell, per volume at X, j as of `follow`."""
        return self._energies() / self.cells.volumes

    def step_along(self, v: fem.Function) -> VolumeStep:
        """Return what changes along a step v from the present u; collective."""
        self.follow()
        self._B.assemble()
        cells = self.cells
        return VolumeStep(
            ratio=cells.values(self._ratio).copy(),
            change=cells.coefficients(self._B.times(v)),
            energy=self._energies(),
            slope=cells.vectors(self._energy_forms[1]),
            stiffness=cells.matrices(self._energy_forms[2]),
            inverse=cells.inverse,
        )

    def norm_squared(self, v: fem.Function) -> float:
        """Return sum_c int K (B v / V)^2 over the owned cells, K that of small strains."""
        self._B.assemble()
        change = self.cells.coefficients(self._B.times(v))
        bulk = self.cells.matrices(self._bulk_form)
        return float(np.einsum("ck,ckl,cl->", change, bulk, change))

    def add_tangent(self, K: PETSc.Mat) -> None:
        """Add B^T (U''(j) / V) B to a matrix with the pattern of the mesh; collective."""
        self._B.assemble()
        inverse, stiffness = self.cells.inverse, self.cells.matrices(self._energy_forms[2])
        self._B.add_square(inverse @ stiffness @ inverse, K)


def volumetric_energy(region: Region, J: Expr) -> Expr:
    """Return U(J): that of a law of F, of a law that splits K/2 (ln J)^2."""
    if region.law.strain == "finite":
        assert region.law.volumetric is not None
        return region.law.volumetric(J, region.symbols)
    return bulk_modulus_of(region) / 2 * ufl.ln(J) ** 2
