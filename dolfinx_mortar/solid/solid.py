# SPDX-License-Identifier: MIT
"""Bodies: materials on cell tags, committed state, energy, residual and tangent."""

import math
from collections.abc import Mapping
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

import ufl
from dolfinx import fem
from dolfinx.fem import petsc as fem_petsc
from dolfinx.mesh import CellType, Mesh, MeshTags
from dolfinx_mortar.algebra.parallel import any_rank, raised_together
from dolfinx_mortar.common.agreement import check_same_on_all_ranks
from dolfinx_mortar.common.arguments import FLAG, check, instance, integer, one_of
from dolfinx_mortar.common.arrays import Floats
from dolfinx_mortar.common.spaces import check_real, check_space
from dolfinx_mortar.materials import Material
from dolfinx_mortar.materials.response import with_normal
from dolfinx_mortar.solid.forms import Forms, create_responses
from dolfinx_mortar.solid.kinematics import Kinematics, check_radius, choose_kinematics
from dolfinx_mortar.solid.laws import (
    Integral,
    create_eigenstrain,
    create_evaluations,
    create_regions,
)
from dolfinx_mortar.solid.mean_volume import VolumeStep, create_dilatation
from dolfinx_mortar.solid.points import (
    DISSIPATED,
    STORED,
    Energies,
    EnergyDensities,
    PointFields,
    PointState,
)
from dolfinx_mortar.solid.pointwise import create_point_values, normal_strain
from dolfinx_mortar.solid.sources import PointGradients, Volumes, as_cauchy, unchanged
from dolfinx_mortar.solid.term import Term, assemble

# Written first.
OUTPUT_FIELDS = (
    *("stress", "von_mises", "plastic_strain", "plastic_strain_norm"),
    *("back_stress_norm", "hardening"),
)

# Degree of the highest rule on simplices in Basix's table (Xiao and Gimbutas).
HIGHEST_RULE = 30


class Solid(Term):
    """Elasto-plastic bodies on one mesh: energy, forces and tangent.

    Attributes:
        u: displacement; its ghosts must be up to date in every call.
        kinematics: strain measure, weight and rigid motions; plane strain in 2D.
        volumetric: "full" or "reduced".
        regions: the cells of each law, with its parameters.
        eigenstrain: at the integration points, or None; taken from the strain.
        stress: quadrature Function, stored as tensors of `state`; Cauchy's at finite strain.
        fields: results of `evaluate` at the integration points.
        gradients: strain and rotation at u, at the integration points.
        volumes: J = det F at the integration points, None at small strain.
        points: state and results at the integration points.
        forms: compiled forms.
    """

    def __init__(
        self,
        u: fem.Function,
        materials: Material | Mapping[int | str, Material],
        cell_tags: MeshTags | None = None,
        *,
        quadrature_degree: int | None = None,
        kinematics: str | Kinematics | None = None,
        eigenstrain: Any = None,
        volumetric: str = "full",
        strain: str = "small",
        energies: bool = False,
    ) -> None:
        """Create the bodies and compile their forms (collective).

        Args:
            u: displacement, a vector Lagrange Function of degree 1 or 2.
            materials: one law for all cells, or a law per cell tag or name.
            cell_tags: tags of the cells, see `Tags` for names; needed with a law per tag.
            quadrature_degree: None means 2(p - 1), at least 1, on simplices and 2p on
                quadrilaterals and hexahedra, p the degree of u.
            kinematics: "plane_strain" (the default in 2D), "plane_stress" (forces per thickness),
                "axisymmetric" (x[0] is the radius r, x[1] the axis z; components in the order r, z,
                theta; forces, energies and volumes of the whole ring), "spatial" (3D), or a
                `Kinematics`.
            eigenstrain: strain without stress (thermal, misfit, initial): a scalar (isotropic) or a
                3x3 tensor, as a number, an array, a Constant, a Function or UFL of these and of the
                coordinates; or a dictionary of such by cell tag or name, zero at other tags. Its
                data may change between steps. At finite strain F = F_e (I + eigenstrain), above
                -1, and laws see F_e.
            volumetric: "full", or "reduced" (mean dilatation) against volumetric locking of
                quadrilaterals and hexahedra, see `mean_volume`; at finite strain also for other
                cells of degree 2. For laws that split, see `Material`.
            strain: "small", or "finite" for large rotations and strains above a few percent: laws
                of F = I + grad u, virtual work int P : dF[v] dX.
            energies: whether to evaluate `energies` and the fields "stored_energy" and
                "dissipated_energy" in each step; all laws need a potential.

        Raises:
            ValueError: on all ranks, naming an argument that is wrong or differs between ranks; for
                a mesh beyond the axis; for a law with missing or wrong parts.
        """
        check("u", u, instance(fem.Function, "give the displacement, a dolfinx.fem.Function"))
        # before any collective call
        self.given = {"materials": materials, "eigenstrain": eigenstrain}
        check_same_on_all_ranks(
            u.function_space.mesh.comm,
            u=u,
            **self.given,
            cell_tags=cell_tags,
            quadrature_degree=quadrature_degree,
            kinematics=kinematics,
            volumetric=volumetric,
            strain=strain,
            energies=energies,
        )
        check_real("u", u)
        check_space(u.function_space, "u")
        self.u, domain = u, u.function_space.mesh
        self.kinematics = choose_kinematics(kinematics, domain.geometry.dim)
        if check("strain", strain, one_of("small", "finite")) == "finite":
            self.kinematics = self.kinematics.of_finite_strain()
        check_radius(self.kinematics, domain)
        degree = _degree(self.V, quadrature_degree)
        self.regions = create_regions(u, materials, cell_tags, degree, self.kinematics)
        check("energies", energies, FLAG)
        self.eigenstrain = create_eigenstrain(
            u, eigenstrain, cell_tags, degree, self.kinematics.finite
        )
        self.points = PointState(self.regions, degree, self.eigenstrain, energies)
        self.stress, self.volumetric = self.points.stress, volumetric
        integral = Integral(self.regions, self.kinematics, degree)
        self._compile(integral, cell_tags)

    def _compile(self, integral: Integral, cell_tags: MeshTags | None) -> None:
        u, degree, finite = self.u, integral.degree, self.kinematics.finite
        eigen, measured, points = self.eigenstrain, self.kinematics.measure(u), self.points
        seen = measured
        if eigen is not None:
            seen = measured * eigen.inverse if finite else measured - eigen.tensor
        dilatation = create_dilatation(u, self.volumetric, integral, seen, eigen)
        if dilatation is not None and not finite:  # also pointwise laws get the deviator
            seen = ufl.dev(seen)
        at_points = ufl.derivative(seen, u, u) if finite else seen  # F - I, exact if small
        if finite and eigen is not None:
            at_points -= eigen.tensor * eigen.inverse
        inputs = [u] if eigen is None else [u, eigen.function]
        how = self.state, inputs, degree
        points.found = create_point_values(self.regions, at_points, *how, finite=finite)
        responses = create_responses(self.regions, seen, self.state, points.found)
        if dilatation is not None:
            pairs = zip(self.regions, responses, strict=True)
            responses = [dilatation.complete(*pair) for pair in pairs]
        if finite and eigen is not None:
            responses = [eigen.of_whole(response) for response in responses]
        whole = measured
        if finite and self.kinematics.plane_stress:
            normal = 1 + normal_strain(points.found)
            whole = with_normal(measured, normal if eigen is None else normal * eigen.growth[2, 2])
        self.volumes = Volumes(u, whole, degree) if finite else None
        self.gradients = PointGradients(
            *(u, self.kinematics, None if finite else eigen, self.stress),
            small=not finite and self.kinematics.linear_in(u),
        )
        points.shown |= {} if self.volumes is None else {"J": self.volumes.J}
        if DISSIPATED in points.staged:
            volume = None if dilatation is None else dilatation.densities
            of = self.regions, responses, cell_tags, degree
            points.densities = EnergyDensities(*of, of_volume=volume)
            points.shown[STORED] = points.densities.stored
        shown, weight = points.staged | points.shown, self.kinematics.weight
        self.fields = PointFields(self.stress, shown, self.regions, degree, weight)
        with raised_together(self.mesh.comm):
            self.fields.bases  # noqa: B018 - checks the output of the laws
        cauchy = [as_cauchy(r, whole) for r in responses] if finite else responses
        points.evaluations = create_evaluations(self.regions, cauchy, points.staged, self.stress)
        points.evaluations += [] if self.volumes is None else [self.volumes.source]
        self.forms = Forms(u, responses, integral, dilatation, eigen)

    @property
    def V(self) -> fem.FunctionSpace:
        """Space of u."""
        return self.u.function_space

    @property
    def mesh(self) -> Mesh:
        """Mesh of all bodies."""
        return self.V.mesh

    @property
    def quadrature_degree(self) -> int:
        """Degree of the cell integrals."""
        return self.fields.degree

    @property
    def state(self) -> Mapping[str, fem.Function]:
        """Internal variables at the start of the step by name, quadrature Functions.

        Tensors are stored as (xx, yy, zz, xy) in 2D, which are (rr, zz, theta theta, rz) of a ring,
        and (xx, yy, zz, xy, yz, xz) in 3D, the shear being the tensor component.
        """
        return self.points.committed

    @property
    def strain(self) -> str:
        """Measure of strains, "small" or "finite"."""
        return "finite" if self.kinematics.finite else "small"

    @property
    def linear(self) -> bool:  # type: ignore[override]
        """Whether the tangent is constant: laws, strain and parameters."""
        return self.gradients.small and all(region.law.linear for region in self.regions)

    def create_matrix(self, kind: str = "aij") -> PETSc.Mat:
        """Create the empty matrix of the tangent; `kind`: "aij", or "baij" for blocks of nodes."""
        K = fem_petsc.create_matrix(self.forms.tangent.form, kind)
        K.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        return K

    def energy(self, along: tuple[VolumeStep, float] | None = None) -> float | Floats | None:
        """This rank's share of the incremental potential Psi(u); collective.

        `along` is a step of `volume_step` and the length t, for its linearised volumes. None if a
        law has no potential; infinite for det F <= 0. At finite strain with two more addends of sum
        zero, of the size of round-off.
        """
        if self.forms.energy is None:
            return None
        if self.volumes is not None and self.volumes.inverted():
            return math.inf
        self.follow()
        share = float(fem.assemble_scalar(self.forms.energy))
        if self.forms.dilatation is not None:
            share += self.forms.dilatation.energy(along)
        if self.volumes is None:
            return share
        return np.array([share, self.forms.moduli, -self.forms.moduli])

    def potential(self) -> float | None:
        """Psi(u) of all ranks, or None; collective."""
        share, comm = self.energy(), self.mesh.comm
        none = comm.allreduce(share is None)
        return None if none or share is None else float(comm.allreduce(float(np.sum(share))))

    def add_forces(self, F: PETSc.Vec) -> None:
        """Add F(u)_i = int sigma : eps(phi_i) to the owned part of F; collective."""
        self.follow()
        F.array_w[:] += assemble(self.forms.residual, self.forms.force)[: F.local_size]

    def add_tangent(self, K: PETSc.Mat, pressure: Floats | None = None) -> None:
        """Add the consistent tangent dF/du at u, symmetric, without boundary conditions.

        With a pressure (owned cells,) where mean stresses are unknowns, see `mean_volume`.
        """
        self.follow()
        dilatation = self.forms.dilatation
        if pressure is not None and dilatation is not None:
            dilatation.set_pressure(pressure)
        self.forms.tangent.add_to(K)
        K.assemble()
        if dilatation is not None:
            if pressure is not None:
                dilatation.follow()
            dilatation.add_tangent(K)

    def assemble_residual(self, r: PETSc.Vec) -> None:
        """Fill the owned part of r with the internal forces; collective."""
        r.array_w[:] = 0.0
        self.add_forces(r)

    def assemble_tangent(self, K: PETSc.Mat) -> None:
        """Fill K with the tangent; collective."""
        K.zeroEntries()
        self.add_tangent(K)

    def elastic_norm(self, v: fem.Function) -> float:
        """Energy norm sqrt(int eps(v) : C : eps(v)) of a Function of V."""
        self.follow()
        self.forms.direction.x.array[:] = v.x.array
        share, dilatation = fem.assemble_scalar(self.forms.elastic_norm), self.forms.dilatation
        return _root(self, share if dilatation is None else share + dilatation.norm_squared(v))

    def element_force_norm(self) -> float:
        """Norm of the unassembled element forces at u, sqrt(sum_e sum_a |f_ea|^2).

        The scale of round-off in F(u). Exact for degree 1 on simplices; else by gradients at the
        midpoint, without the hoop stress.
        """
        self.follow()
        return _root(self, fem.assemble_scalar(self.forms.element_force))

    def evaluate(self) -> None:
        """Evaluate `stress`, state and `fields` at u, from the committed state; collective.

        Raises:
            ValueError: on all ranks, for NaN or infinity of a law; all results are then as before.
        """
        self.follow()
        self.points.evaluate(self.follow)

    def follow(self) -> None:
        """Update changed data of the forms, evaluate pointwise laws; collective.

        A ValueError on all ranks for invalid data or results of a law.
        """
        dilatation = self.forms.dilatation
        self.points.follow(None if dilatation is None else dilatation.follow)
        self.forms.committed.complete()

    def commit(self) -> None:
        """Commit the internal variables of the last `evaluate`."""
        self.points.commit()
        self.forms.committed.forget()
        self.forms.committed.complete()

    def energies(self) -> dict[int | str, Energies]:
        """Energy stored in each body, and dissipated since the start; collective.

            solid.energies()["block"].dissipated

        At the end of the last step, by name or tag of cells, or 0 without ``cell_tags``; of the
        whole ring, or per thickness. Elastic and hardening energy are stored, the rest of the
        plastic work is dissipated; for friction see `Contact.dissipation`. Their sum is the work of
        supports and loads, up to the error of the trapezoidal rule over load steps.

        Raises:
            ValueError: unless the solid was made with ``energies=True``.
        """
        if self.points.densities is None:
            raise ValueError(
                "energies were not followed: make the solid with Solid(.., energies=True)"
            )
        return self.points.densities.by_body(self.fields)

    def max(self, name: str) -> float:
        """Largest value of a scalar field over all integration points (collective).

        `name` as in `PointFields.values`, such as "von_mises"; a ValueError for tensors and
        unknown names.
        """
        return self.fields.max(name)

    def cell_values(self, name: str) -> fem.Function:
        """Cell averages of a field as a DG0 Function, refilled at every call."""
        return self.fields.cell_values(name)

    def output_fields(self) -> dict[str, fem.Function]:
        """Cell averages for output, by name, in the user's units (collective).

        Stress, internal variables and output of the laws, of the last `evaluate`.
        ``plastic_strain_norm`` and ``back_stress_norm`` are Frobenius norms, ``hardening`` is the
        vector norm of the stored back stress components.
        """
        first = [name for name in OUTPUT_FIELDS if name in self.fields.names]
        return {
            name: self.cell_values(name) for name in dict.fromkeys([*first, *self.fields.bases])
        }

    def plastic_area(self) -> float:
        """Area (volume of spatial bodies and rings) with plastic strain.

        A law's `output` may define it by a field ``plastic``, one or zero.
        """
        return self.fields.integral("plastic") if "plastic" in self.fields.names else 0.0


def _root(solid: Solid, share: float) -> float:
    return math.sqrt(max(solid.mesh.comm.allreduce(share, op=MPI.SUM), 0.0))


def flows_at_start(solid: Solid) -> bool:
    """Whether changes since the last commit may make bodies flow; collective.

    A step then begins with `add_first_forces` and `add_first_tangent`. At finite strain whether the
    eigenstrain has changed, and u has not: the stress that it makes may be beyond buckling.
    """
    finite = solid.kinematics.finite
    if solid.eigenstrain is None if finite else not (solid.gradients.small and solid.state):
        return False
    solid.follow()
    moved, *others = any_rank(solid.mesh.comm, *solid.forms.committed.differ())
    if finite:
        return bool(others[0] and not moved)
    if not (moved or any(others)):
        return False
    with unchanged(solid.points.lasting_fields().values()):
        solid.evaluate()
        return bool(any_rank(solid.mesh.comm, solid.points.flowing().any())[0])


def add_first_forces(solid: Solid, F: PETSc.Vec) -> None:
    """Add forces linearised about the committed state to F; collective.

        F_n + int C_n : (eps(u - u_n) - (e - e_n)) : eps(v),    C_n the tangent of that state;

    at finite strain about u and the committed eigenstrain, F(u, e_n) - int C : F_e (e - e_n) : dF.

    The stress by an eigenstrain e or parameters, bounded by yield, does not measure the distance to
    equilibrium.
    """
    solid.follow()
    committed, dilatation = solid.forms.committed, solid.forms.dilatation
    form, changes = committed.change
    for change, f, kept in zip(changes, committed.strained, committed.complete(), strict=False):
        change.x.array[:] = f.x.array - kept
    stress = [] if dilatation is None else [dilatation.mean_stress.x.array]
    now = [values.copy() for values in stress]
    with committed.put():
        solid.follow()
        for values, mean in zip(stress, now, strict=True):
            values[:] = mean
        for part in (solid.forms.residual, form):
            F.array_w[:] += assemble(part, solid.forms.force)[: F.local_size]


def add_first_tangent(solid: Solid, K: PETSc.Mat) -> None:
    """Add the tangent of the committed state to K; collective."""
    with solid.forms.committed.put():
        solid.add_tangent(K)


def volume_step(solid: Solid, du: fem.Function) -> VolumeStep | None:
    """Volumes and pressures along a step, None without means of J; collective."""
    dilatation = solid.forms.dilatation
    finite = solid.kinematics.finite
    return dilatation.step_along(du) if dilatation is not None and finite else None


def _degree(V: fem.FunctionSpace, given: int | None) -> int:
    if given is not None:
        rule = integer(0, HIGHEST_RULE)
        return check("quadrature_degree", given, rule, f"{rule.remedy}, or None")
    p = V.element.basix_element.degree
    simplex = V.mesh.topology.cell_type in (CellType.triangle, CellType.tetrahedron)
    return max(2 * (p - 1), 1) if simplex else 2 * p
