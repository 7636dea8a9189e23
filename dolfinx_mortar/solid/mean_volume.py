# SPDX-License-Identifier: MIT
r"""Mean dilatation at finite strain: one volume ratio per cell, the mean of J = det F.

Where a body keeps its volume, J = 1 at every point is too many conditions for cells of first order:
they lock. So of laws whose energy has a part of the volume alone,

    psi(F) = psi_0(F) + U(J),

that part is taken in the mean over each cell,

    psi_vol = V U(j),    j = 1/V int J dX,

V the volume of the cell at X, with the weight of the kinematics. Its forces are p B^T with the mean
stress p = U'(j) and B_a = int dJ/du_a dX; its tangent is p d2J/du2, a part of the forms, and B^T
(U''(j) / V) B. So energy, forces and tangent belong together.

Where U'' is far above the other moduli, Newton's method on u alone takes many short steps: after
one that changes shears by e, j is wrong by e^2, and p by U'' e^2, which makes the next tangent
indefinite and the energy larger. If p is an unknown beside u, a step leaves it where its
linearisation goes,

    p + U''(j) B du / V,

and its forces are those of U'(j(u)) at the next iterate all the same. Only p d2J/du2 of the next
tangent has the p of the linearisation, and the energy along a step its volumes (`VolumeStep`). At
the solution both p are the same, and the rate stays quadratic.

Sources: Simo, Taylor, Pister, Comput. Methods Appl. Mech. Engrg. 51 (1985) 177-208, with constant
pressure and dilatation in each cell; for the tangent D. Magisano, L. Leonetti, G. Garcea, Comput.
Methods Appl. Mech. Engrg. 313 (2017) 986-1005, who treat all stresses so.
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
from dolfinx import fem
from dolfinx.fem import petsc as fem_petsc
from dolfinx_mortar.algebra.congruence import as_aij
from dolfinx_mortar.arguments import is_name
from dolfinx_mortar.arrays import Floats
from dolfinx_mortar.materials.response import Response
from dolfinx_mortar.solid.dilatation import MeanDilatation, bulk_modulus_of, check_reducible
from dolfinx_mortar.solid.eigenstrain import Eigenstrain
from dolfinx_mortar.solid.kinematics import Kinematics
from dolfinx_mortar.solid.laws import Region, measure, measures
from dolfinx_mortar.solid.term import assemble, create_vector
from ufl.algorithms import expand_derivatives, strip_variables
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
    if not is_name(given, ("full", "reduced")):
        raise ValueError(f"volumetric is {given!r}: choose 'full' or 'reduced'")
    if given == "full":
        return None
    check_reducible(u.function_space, regions, kinematics, degree)
    if kinematics.finite:
        return MeanVolume(u, regions, kinematics, degree)
    return MeanDilatation(u, regions, kinematics, degree, eigenstrain)


@dataclass(frozen=True)
class VolumeStep:
    """Volumes and pressures along a step u + t du, as linearised at u."""

    ratio: Floats  # (owned cells,) j at u
    change: Floats  # B du / V
    energy: Floats  # U(j)
    pressure: Floats  # U'(j)
    stiffness: Floats  # U''(j)

    def pressure_at(self, t: float) -> Floats:
        """Return p + t U'' B du / V."""
        return self.pressure + t * self.stiffness * self.change

    def energy_at(self, t: float, ratio: Floats) -> Floats:
        """Return the energy per volume at another j, linear in what the linearisation misses.

        It is below U(j), if that is convex, by U''/2 times the square of what is missed.
        """
        way = t * self.change
        along = self.energy + self.pressure * way + self.stiffness / 2 * way**2
        return along + self.pressure_at(t) * (ratio - self.ratio - way)


class MeanVolume:
    """The part of the energy that depends on the volume, in the mean over each cell.

    Attributes:
        mean_stress: p = U'(j) per cell, a DG0 Function; up to date after `follow`.
    """

    def __init__(
        self, u: fem.Function, regions: Sequence[Region], kinematics: Kinematics, degree: int
    ) -> None:
        """Compile; collective."""
        V = u.function_space
        Q = fem.functionspace(V.mesh, ("DG", 0))
        self.mean_stress, self._ratio = fem.Function(Q, name="mean_stress"), fem.Function(Q)
        self._ratio.x.array[:] = 1.0
        self._gradient, self._u, self._vector = kinematics.measure(u), u, create_vector(Q)
        dx, parts = measure(V.mesh, degree), measures(V, regions, degree)
        size = kinematics.weight(ufl.SpatialCoordinate(V.mesh)) * ufl.TestFunction(Q)
        J = ufl.det(self._gradient)
        change = ufl.derivative(J, u, ufl.TrialFunction(V))
        self._B_form = fem.form(size * change * dx)
        self._B = fem_petsc.create_matrix(self._B_form)
        self._volumes = assemble(fem.form(size * dx), self._vector).copy()
        self._volume_form = fem.form(size * J * dx)

        def summed(order: int) -> fem.Form:
            pairs = zip(regions, parts, strict=True)
            return fem.form(reduce(add, (self._slope(r, order) * size * on for r, on in pairs)))

        self._energies = [summed(order) for order in range(3)]
        moduli = [bulk_modulus_of(r) * size * on for r, on in zip(regions, parts, strict=True)]
        self._bulk_form = fem.form(reduce(add, moduli))

    def _slope(self, region: Region, order: int) -> Expr:
        """Return a derivative of U at the mean ratio."""
        j = Variable(self._ratio, Label(-4))
        value = volumetric_energy(region, j)
        for _ in range(order):
            value = ufl.diff(value, j)
        return strip_variables(expand_derivatives(value))

    def complete(self, region: Region, response: Response) -> Response:
        """Return a response with p in place of U'(J), and without U(J) in the energy."""
        F, p = self._gradient, self.mean_stress

        def stress(gradient: Expr) -> Expr:
            J = ufl.det(gradient)
            slope = ufl.replace(self._slope(region, 1), {self._ratio: J})
            return (p - slope) * J * ufl.transpose(ufl.inv(gradient))

        def change(direction: Expr) -> Expr:
            step = Variable(ufl.as_ufl(0.0), Label(-5))
            slope = ufl.diff(stress(F + step * direction), step)
            return response.change(direction) + strip_variables(expand_derivatives(slope))

        energy = response.energy
        energy = None if energy is None else energy - volumetric_energy(region, ufl.det(F))
        total = response.stress + stress(F)
        return dataclasses.replace(response, stress=total, energy=energy, change=change)

    def follow(self) -> None:
        """Take over the displacement and the parameters of the laws; collective."""
        volumes = assemble(self._volume_form, self._vector)
        self._ratio.x.array[: len(volumes)] = volumes / self._volumes
        self._ratio.x.scatter_forward()
        slopes = assemble(self._energies[1], self._vector) / self._volumes
        self.mean_stress.x.array[: len(slopes)] = slopes
        self.mean_stress.x.scatter_forward()

    def energy(self, along: tuple[VolumeStep, float] | None = None) -> float:
        """Return sum_c V U(j) over the owned cells, as `follow` found j.

        Along a step, at the length t, `VolumeStep.energy_at`.
        """
        if along is None:
            return float(assemble(self._energies[0], self._vector).sum())
        step, t = along
        ratio = self._ratio.x.array[: len(step.ratio)]
        return float(self._volumes @ step.energy_at(t, ratio))

    def step_along(self, v: fem.Function) -> VolumeStep:
        """Return what changes along a step v from the present u; collective."""
        self.follow()
        self._assemble()
        change = np.asarray((self._B * v.x.petsc_vec).array) / self._volumes
        found = [assemble(form, self._vector) / self._volumes for form in self._energies]
        return VolumeStep(self._ratio.x.array[: len(change)].copy(), change, *found)

    def set_pressure(self, pressure: Floats) -> None:
        """Let the mean stress be that of owned cells, until the next `follow`; collective."""
        self.mean_stress.x.array[: len(pressure)] = pressure
        self.mean_stress.x.scatter_forward()

    def densities(self) -> Floats:
        """Return U(j) of the owned cells, per volume at X, as `follow` found j; collective."""
        return np.asarray(assemble(self._energies[0], self._vector) / self._volumes)

    def norm_squared(self, v: fem.Function) -> float:
        """Return sum_c K / V (B v)^2 over the owned cells, K that of small strains; collective."""
        bulk = assemble(self._bulk_form, self._vector) / self._volumes
        self._assemble()
        change = np.asarray((self._B * v.x.petsc_vec).array)
        return float((bulk / self._volumes * change**2).sum())

    def add_tangent(self, K: PETSc.Mat) -> None:
        """Add B^T (U''(j) / V) B to a matrix with the pattern of the mesh; collective."""
        self._assemble()
        stiffness: Floats = assemble(self._energies[2], self._vector) / self._volumes**2
        root, sign = self._B.createVecLeft(), self._B.createVecLeft()
        root.array[:], sign.array[:] = np.sqrt(np.abs(stiffness)), np.sign(stiffness)
        scaled = self._B.copy()
        scaled.diagonalScale(root)
        signed = scaled.copy()
        signed.diagonalScale(sign)
        result = as_aij(K).duplicate(copy=False)
        result.zeroEntries()
        result.assemble()
        product = scaled.transposeMatMult(signed)
        result.axpy(1.0, product, PETSc.Mat.Structure.SUBSET_NONZERO_PATTERN)
        K.axpy(1.0, result.convert(K.getType()), PETSc.Mat.Structure.SAME_NONZERO_PATTERN)

    def _assemble(self) -> None:
        """Assemble B at u; collective."""
        self._B.zeroEntries()
        fem_petsc.assemble_matrix(self._B, self._B_form)
        self._B.assemble()


def volumetric_energy(region: Region, J: Expr) -> Expr:
    """Return U(J): that of a law of F, of a law that splits K/2 (ln J)^2."""
    if region.law.strain == "finite":
        assert region.law.volumetric is not None
        return region.law.volumetric(J, region.symbols)
    return bulk_modulus_of(region) / 2 * ufl.ln(J) ** 2
