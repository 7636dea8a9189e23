# SPDX-License-Identifier: MIT
"""The bodies: materials on cell tags, committed state, energy, residual and tangent.

A step ends with `evaluate`, which shows its results, and is accepted by `commit`.

Everything that a step needs is compiled and allocated when a `Solid` is made; only averages over
cells, which serve output, when first asked for.
The compiled code depends on the cell type and the laws, not on the mesh, the tags or the values of
the parameters, which live in Functions. Parameters that the user changes are followed by whatever
is assembled or evaluated next.
"""

import math
from collections.abc import Mapping
from functools import cached_property, partial
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

import ufl
from dolfinx import fem
from dolfinx.fem import petsc as fem_petsc
from dolfinx.mesh import CellType, Mesh, MeshTags
from dolfinx_mortar.agreement import check_same_on_all_ranks
from dolfinx_mortar.algebra.errors import raised_together
from dolfinx_mortar.algebra.parallel import any_rank
from dolfinx_mortar.arguments import FLAG, check, instance, integer
from dolfinx_mortar.arrays import Bools, Floats
from dolfinx_mortar.materials import Material
from dolfinx_mortar.materials.plane_stress import with_normal_stretch
from dolfinx_mortar.solid.committed_data import CommittedData
from dolfinx_mortar.solid.dilatation import MeanDilatation
from dolfinx_mortar.solid.eigenstrain import create_eigenstrain
from dolfinx_mortar.solid.energies import DISSIPATED, STORED, Energies, EnergyDensities
from dolfinx_mortar.solid.finite_strain import Volumes, as_cauchy, check_finite
from dolfinx_mortar.solid.forms import (
    create_change,
    create_elastic,
    create_forms,
    create_moduli,
    create_responses,
)
from dolfinx_mortar.solid.gradients import PointGradients
from dolfinx_mortar.solid.kinematics import Kinematics, check_radius, choose_kinematics
from dolfinx_mortar.solid.laws import create_regions
from dolfinx_mortar.solid.mean_volume import MeanVolume, VolumeStep, create_dilatation
from dolfinx_mortar.solid.points import PointFields
from dolfinx_mortar.solid.pointwise import (
    create_point_values,
    fill_point_values,
    largest_stress_lost,
    normal_strain,
)
from dolfinx_mortar.solid.sources import Followed, follow_changed
from dolfinx_mortar.solid.state import create_evaluations, create_field, create_state, fill_all
from dolfinx_mortar.solid.term import MatrixForm, Term, assemble
from dolfinx_mortar.spaces import check_real, check_space, mean_cell_sizes

# Written first, and if a law has them; then all internal variables and the output of the laws.
OUTPUT_FIELDS = (
    *("stress", "von_mises", "plastic_strain", "plastic_strain_norm"),
    *("back_stress_norm", "hardening"),
)

# Degree of the highest rule on simplices that Basix has in a table (Xiao and Gimbutas); beyond it
# come products with a number of points that only memory limits.
HIGHEST_RULE = 30


class Solid(Term):
    """Elasto-plastic bodies on one mesh: energy, forces and tangent at u and the committed state.

    Attributes:
        u: displacement; its ghosts must be up to date in every call.
        kinematics: strain measure, weight and rigid motions; plane strain in 2D.
        eigenstrain: the strain that the laws do not see, at the integration points, or None.
        stress: quadrature Function of the same components, filled by `evaluate`; Cauchy's at
            finite strain.
        regions: the cells of each law, with its parameters.
        fields: what `evaluate` found, at the integration points.
        gradients: strain and rotation at u, at the integration points.
        inputs: the Constants in the arguments, in which ranks must agree at every step.
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
            materials: one law for all cells, or a law per cell tag, or its name.
            cell_tags: tags of the cells, see `Tags` for names; needed with a law per tag.
            quadrature_degree: None means 2(p - 1), at least 1, on simplices and 2p on
                quadrilaterals and hexahedra, p the degree of u.
            kinematics: "plane_strain" (the default in 2D), "plane_stress" (thin plates, forces per
                thickness), "axisymmetric" (x[0] is the radius r, x[1] the axis z; strains, stresses
                and loads are in the order r, z, theta, forces, energies and volumes those of the
                whole ring), "spatial" (the only choice in 3D), or a `Kinematics`.
            eigenstrain: strain without stress (thermal, of a fit, initial), which is subtracted
                from the strain before laws are evaluated: a scalar (the same in all three
                directions, also out of the plane) or a 3x3 tensor, as a number, an array, a
                Constant, a Function or UFL of these and of the coordinates; or a dictionary of such
                by cell tag or name, zero at other tags. What it depends on may change between
                steps, as loads do: in ``on_time`` of `load_steps`.
            volumetric: "full", or "reduced" (mean dilatation) for quadrilaterals and hexahedra,
                which then do not lock where their volume hardly changes: the trace of the strain
                and the mean stress are their means over the cell. For laws that split into a
                deviator and a trace, see `Material`. At finite strain for cells of degree 2 of all
                shapes, too: the volume ratio is then linear in quadrilaterals and hexahedra, see
                `mean_volume`.
            strain: "small", or "finite" for large rotations and strains of more than a few percent:
                laws are functions of the deformation gradient F = I + grad u, and the internal
                virtual work is int P : dF[v] dX. Without eigenstrain.
            energies: whether stored and dissipated energies are evaluated at the end of each step,
                for `energies`, and as the fields "stored_energy" and "dissipated_energy". All laws
                need a potential.

        Raises:
            ValueError: on all ranks, naming an argument that is wrong or differs between ranks; for
                a mesh beyond the axis; for a law that lacks a part, raises, or returns something of
                the wrong name or shape, with law and part.
        """
        check("u", u, instance(fem.Function, "give the displacement, a dolfinx.fem.Function"))
        # before anything that ranks do together
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
        self.u = u
        self.kinematics = choose_kinematics(kinematics, self.mesh.geometry.dim)
        check_finite(strain, eigenstrain)
        if strain == "finite":
            self.kinematics = self.kinematics.of_finite_strain()
        check_radius(self.kinematics, self.mesh)
        degree = _degree(self.V, quadrature_degree)
        self.regions = create_regions(u, materials, cell_tags, degree, self.kinematics)
        self._committed = create_state(self.regions, self.mesh, degree)
        if check("energies", energies, FLAG):
            self._committed[DISSIPATED] = create_field(self.mesh, degree, (), DISSIPATED)
        self._staged = {name: f.copy() for name, f in self._committed.items()}
        self.stress = create_field(self.mesh, degree, (3, 3), "stress")
        self.eigenstrain = create_eigenstrain(u, eigenstrain, cell_tags, degree)
        self._compile(volumetric, degree, cell_tags)

    def _compile(self, volumetric: str, degree: int, cell_tags: MeshTags | None) -> None:
        """Compile the forms, and what is evaluated at points; collective."""
        u, finite = self.u, self.kinematics.finite
        how = u, volumetric, self.regions, self.kinematics, degree
        dilatation = create_dilatation(*how, eigenstrain=self.eigenstrain)
        measured = self.kinematics.measure(u)
        seen = measured if self.eigenstrain is None else measured - self.eigenstrain.tensor
        mean_stress = None
        if isinstance(dilatation, MeanDilatation):  # laws, pointwise ones too, see the deviator
            seen, mean_stress = ufl.dev(seen), dilatation.mean_stress
        inputs = [u] if self.eigenstrain is None else [u, self.eigenstrain.function]
        found = create_point_values(self.regions, seen, self.state, inputs, degree, finite=finite)
        responses = create_responses(seen, self.regions, self.state, found, mean_stress)
        if isinstance(dilatation, MeanVolume):
            pairs = zip(self.regions, responses, strict=True)
            responses = [dilatation.complete(*pair) for pair in pairs]
        weight, whole = self.kinematics.weight, measured
        if finite and self.kinematics.plane_stress:
            whole = with_normal_stretch(measured, normal_strain(found))
        self.gradients = PointGradients(
            *(u, self.kinematics, self.eigenstrain, self.stress),
            small=not finite and self.kinematics.linear_in(u),
            volumes=Volumes(u, whole, degree) if finite else None,
        )
        self.densities = None
        if DISSIPATED in self._staged:
            volume = None if dilatation is None else dilatation.densities
            of = self.regions, responses, self.mesh, cell_tags, degree
            self.densities = EnergyDensities(*of, of_volume=volume)
        shown = {**self._staged, **self._shown}
        self.fields = PointFields(self.stress, shown, self.regions, degree, weight)
        with raised_together(self.mesh.comm):
            self.fields.bases  # noqa: B018 - checks the output of the laws
        cauchy = [as_cauchy(r, whole) for r in responses] if finite else responses
        evaluations = create_evaluations(self.regions, cauchy, self._staged, self.stress)
        if self.volumes is not None:
            evaluations.append(self.volumes.source)
        laws = self.regions, responses
        points = evaluations, found
        parameters = [region.parameters for region in self.regions]
        change = partial(create_change, u, *laws, self.kinematics, degree, self.eigenstrain)
        self._forms = create_forms(
            *(u, *laws, self.kinematics, degree),
            points=points,
            dilatation=dilatation,
            committed=CommittedData(u, self.eigenstrain, parameters, change),
        )

    @property
    def volumes(self) -> Volumes | None:
        """J = det F at the integration points, None at small strain."""
        return self.gradients.volumes

    @property
    def _shown(self) -> dict[str, fem.Function]:
        """What `evaluate` fills beside the stress and the internal variables, by name."""
        shown = {} if self.volumes is None else {"J": self.volumes.J}
        return shown if self.densities is None else {**shown, STORED: self.densities.stored}

    @property
    def V(self) -> fem.FunctionSpace:
        """The space of u."""
        return self.u.function_space

    @property
    def mesh(self) -> Mesh:
        """The mesh of all bodies."""
        return self.V.mesh

    @property
    def quadrature_degree(self) -> int:
        """The degree of the cell integrals."""
        return self.fields.degree

    @property
    def state(self) -> Mapping[str, fem.Function]:
        """Committed internal variables by name, quadrature Functions: a step starts from them.

        What `fields` and `max` show is the state that `evaluate` found, committed or not. Tensors
        are stored as (xx, yy, zz, xy) in 2D, which are (rr, zz, theta theta, rz) of a ring, and
        (xx, yy, zz, xy, yz, xz) in 3D, the shear being the tensor component.
        """
        return self._committed

    @property
    def strain(self) -> str:
        """How strains are measured, "small" or "finite"."""
        return "finite" if self.kinematics.finite else "small"

    @property
    def linear(self) -> bool:  # type: ignore[override]
        """Whether all laws and the strain are linear: a constant tangent while parameters are."""
        return self.gradients.small and all(region.law.linear for region in self.regions)

    @property
    def varying(self) -> bool:
        """Whether a parameter is a Constant, a Function or UFL, whose values may change."""
        return any(region.parameters.varying for region in self.regions)

    @property
    def follows(self) -> bool:
        """Whether parameters or the eigenstrain may change."""
        return any(followed.varying for followed in self._followed())

    @property
    def volumetric(self) -> str:
        """How the volumetric part is integrated, "full" or "reduced"."""
        return "full" if self._forms.dilatation is None else "reduced"

    # -- one Newton iteration -------------------------------------------------------------------

    def create_matrix(self, kind: str = "aij") -> PETSc.Mat:
        """Create the matrix of the tangent: V's layout, pattern of the mesh, no entries.

        Args:
            kind: "aij", or "baij" for blocks of nodes.
        """
        K = fem_petsc.create_matrix(self._forms.tangent.form, kind)
        K.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        return K

    def energy(self, along: tuple[VolumeStep, float] | None = None) -> float | Floats | None:
        """Return this rank's share of the incremental potential Psi(u); collective.

        Along a step of `volume_step`, at the length t, with the volumes of its linearisation.

        None if a law gives a stress but no potential. Infinite where any point of a finite strain
        has no positive volume, det F <= 0. At finite strain with two more addends, whose sum is
        zero: energies of F are differences of numbers near the moduli, which is their round-off.
        """
        if self._forms.energy is None:
            return None
        if self.volumes is not None and self.volumes.inverted():
            return math.inf
        self.follow()
        share, dilatation = float(fem.assemble_scalar(self._forms.energy)), self._forms.dilatation
        if isinstance(dilatation, MeanVolume):
            share += dilatation.energy(along)
        elif dilatation is not None:
            share += dilatation.energy()
        return share if self.volumes is None else np.array([share, self._moduli, -self._moduli])

    def potential(self) -> float | None:
        """Return Psi(u) of all ranks, None without; collective."""
        share, comm = self.energy(), self.mesh.comm
        none = comm.allreduce(share is None)
        return None if none or share is None else float(comm.allreduce(float(np.sum(share))))

    @cached_property
    def _moduli(self) -> float:
        """The integral over this rank's cells of the norm of the elastic stress of a unit shear."""
        return float(fem.assemble_scalar(create_moduli(self.regions, self.kinematics, self.stress)))

    @cached_property
    def cell_sizes(self) -> Floats:
        """Mean size of the cells around the node of each owned dof (n,); collective at first."""
        return mean_cell_sizes(self.V)

    def add_forces(self, F: PETSc.Vec) -> None:
        """Add F(u)_i = int sigma : eps(phi_i) to the owned part of F; collective."""
        self.follow()
        F.array_w[:] += assemble(self._forms.residual, self._forms.force)[: F.local_size]

    def add_tangent(self, K: PETSc.Mat, pressure: Floats | None = None) -> None:
        """Add the consistent tangent dF/du at u, symmetric, without boundary conditions.

        With a pressure (owned cells,) that where mean stresses are unknowns of their own, see
        `mean_volume`.
        """
        self.follow()
        dilatation = self._forms.dilatation
        if pressure is not None and isinstance(dilatation, MeanVolume):
            dilatation.set_pressure(pressure)
        self._forms.tangent.add_to(K)
        K.assemble()
        if dilatation is not None:
            dilatation.follow()
            dilatation.add_tangent(K)

    def flows_at_start(self) -> bool:
        """Tell whether what has changed since the last commit makes bodies flow; collective.

        Then a step begins with `add_first_forces` and `add_first_tangent`. False at finite strain,
        where a tangent that is singular is shifted, see `newton`.
        """
        if not self.gradients.small or not self._staged:
            return False
        self.follow()
        if not any_rank(self.mesh.comm, self._forms.committed.differ())[0]:
            return False
        kept = self.keep()
        try:
            self.evaluate()
            return bool(any_rank(self.mesh.comm, self.flowing().any())[0])
        finally:
            self.put_back(kept)

    def add_first_forces(self, F: PETSc.Vec) -> None:
        """Add forces linearised about the committed state to the owned part of F; collective.

        Those that `add_forces` would give if no point had flowed since, see `committed_data`.
        """
        self.follow()
        change, dilatation = self._forms.committed.change(), self._forms.dilatation
        linear = [] if dilatation is None else [dilatation.mean_stress.x.array]
        mean_stress = [values.copy() for values in linear]
        with self._forms.committed.put():
            self.follow()
            for values, now in zip(linear, mean_stress, strict=True):
                values[:] = now
            for form in (self._forms.residual, change):
                F.array_w[:] += assemble(form, self._forms.force)[: F.local_size]

    def add_first_tangent(self, K: PETSc.Mat) -> None:
        """Add the tangent of the committed state to K, see `add_tangent`; collective."""
        with self._forms.committed.put():
            self.add_tangent(K)

    def volume_step(self, du: fem.Function) -> VolumeStep | None:
        """Return volumes and pressures along a step, None unless mean; collective."""
        dilatation = self._forms.dilatation
        return dilatation.step_along(du) if isinstance(dilatation, MeanVolume) else None

    def add_elastic(self, K: PETSc.Mat, factor: float) -> None:
        """Add a multiple of the stiffness of `elastic_norm`, which is positive; collective."""
        form, share = self._elastic
        share.value = factor
        form.add_to(K)
        K.assemble()

    @cached_property
    def _elastic(self) -> tuple[MatrixForm, fem.Constant]:
        """The form of the elastic stiffness, and its factor; few steps need it."""
        return create_elastic(self.u, self.regions, self.kinematics, self.quadrature_degree)

    def assemble_residual(self, r: PETSc.Vec) -> None:
        """Fill the owned part of r with the internal forces, see `add_forces`; collective."""
        r.array_w[:] = 0.0
        self.add_forces(r)

    def assemble_tangent(self, K: PETSc.Mat) -> None:
        """Fill K with the tangent, see `add_tangent`; collective."""
        K.zeroEntries()
        self.add_tangent(K)

    def elastic_norm(self, v: fem.Function) -> float:
        """Return the energy norm sqrt(int eps(v) : C : eps(v)) of a Function of V."""
        self.follow()
        self._forms.direction.x.array[:] = v.x.array
        share, dilatation = fem.assemble_scalar(self._forms.elastic_norm), self._forms.dilatation
        return self._root(share if dilatation is None else share + dilatation.norm_squared(v))

    def element_force_norm(self) -> float:
        """Return the norm of the unassembled element forces at u, sqrt(sum_e sum_a |f_ea|^2).

        This is the scale of round-off in F(u), and does not vanish with residual stresses. Exact
        for degree 1 on simplices; on other cells the gradients at the midpoint are used, and of
        rings the forces of the stress along them, which are never larger than the others, left out.
        """
        self.follow()
        return self._root(fem.assemble_scalar(self._forms.element_force))

    def _root(self, share: float) -> float:
        """Return the root of a sum over all ranks."""
        return math.sqrt(max(self.mesh.comm.allreduce(share, op=MPI.SUM), 0.0))

    # -- results and committed state ------------------------------------------------------------

    def evaluate(self) -> None:
        """Evaluate stress and internal variables at u and the committed state; collective.

        These are the results of the step whose displacement is u: `stress`, `fields` and all that
        rests on them show them from now on. The committed state stays as it is.

        Raises:
            ValueError: on all ranks, if a law gives NaN or infinity on any; the message names it.
                All that is shown, and what `commit` would take, is then as before.
        """
        self.follow()
        fill_point_values(self.mesh.comm, self._forms.found, at_end=True)
        if self.densities is None:
            fill_all(self.mesh.comm, self._forms.evaluations)
            return
        kept = self.keep()
        try:
            fill_all(self.mesh.comm, self._forms.evaluations)
            self.densities.fill(self._committed, self._staged, self.follow)
        except BaseException:
            self.put_back(kept)
            raise

    def keep(self) -> list[tuple[fem.Function, Floats]]:
        """Return copies of results, state, and the parameters that they rest on, for `put_back`.

        A second evaluation would differ: u may have been set since, or nothing evaluated yet, and
        a law that depends on the size of a step would flow further.
        """
        shown = [self.stress, *self._staged.values(), *self._committed.values()]
        shown += self._shown.values()
        functions = shown + [followed.function for followed in self._followed()]
        return [(f, f.x.array.copy()) for f in functions]

    def put_back(self, kept: list[tuple[fem.Function, Floats]]) -> None:
        """Restore the results that `keep` has returned; without communication."""
        for f, values in kept:
            f.x.array[:] = values
        for followed in self._followed():
            followed.forget()

    def _followed(self) -> list[Followed]:
        """Return the parameters of the laws and the eigenstrain."""
        parameters: list[Followed] = [region.parameters for region in self.regions]
        return parameters if self.eigenstrain is None else [*parameters, self.eigenstrain]

    def follow(self) -> None:
        """Update the data of the forms that have changed, evaluate pointwise laws; collective.

        Raises:
            ValueError: on all ranks, if parameters are out of range, the eigenstrain is undefined,
                or a pointwise law fails.
        """
        follow_changed(self.mesh.comm, self._followed())
        if self._forms.dilatation is not None:
            self._forms.dilatation.follow()
        fill_point_values(self.mesh.comm, self._forms.found)
        self._forms.committed.complete()

    def commit(self) -> None:
        """Make the internal variables of the last `evaluate` the committed ones.

        Results do not change.
        """
        for name, staged in self._staged.items():
            self._committed[name].x.array[:] = staged.x.array
        self._forms.committed.keep()

    def forget_data(self) -> None:
        """Take what is followed next for the data of the committed state, which was restored."""
        self._forms.committed.forget()

    def lasting_fields(self) -> dict[str, fem.Function]:
        """Return the fields at integration points that are kept from step to step, by name.

        The stress, the internal variables that are committed, and those that `evaluate` found last,
        which are what is shown.
        """
        committed = {f"committed/{name}": f for name, f in self.state.items()}
        shown = {f"shown/{name}": f for name, f in self._staged.items()}
        return {"stress": self.stress} | committed | self._shown | shown

    def flowing(self) -> Bools:
        """Return at which points (owned cells, points) `evaluate` has changed internal variables.

        Laws leave the state of a point that does not flow exactly as it is.
        """
        points = self.fields.weights.shape
        changed = np.zeros(points, dtype=bool)
        for name, staged in self._staged.items():
            dofmap = staged.function_space.dofmap
            differs = staged.x.array != self.state[name].x.array
            per_point = differs.reshape(-1, dofmap.bs).any(axis=1)
            changed |= per_point[dofmap.list[: points[0]]]
        return changed

    def stress_lost(self) -> tuple[float, str]:
        """Return the largest share of its stress that a law loses by shear, and its name.

        At finite strain, in laws with internal variables in the additive form, see
        `materials.logarithmic`; at the u of the last assembly or `evaluate`; collective.
        """
        return largest_stress_lost(self.mesh.comm, self._forms.found)

    def energies(self) -> dict[int | str, Energies]:
        """Return the energy stored in each body, and dissipated since the start; collective.

            solid.energies()["block"].dissipated

        Bodies are the cells of a tag, under its name if it has one; without ``cell_tags`` there is
        one, 0. As `evaluate` found them at the end of the last step; of the whole ring, or per
        thickness. Elastic energy and that of hardening are stored, plastic work less the latter is
        dissipated; what friction dissipates is in `Contact.dissipation`. So is the work of the
        supports and loads, up to the error of load steps, which is that of the trapezoidal rule.

        Raises:
            ValueError: unless the solid was made with ``energies=True``.
        """
        if self.densities is None:
            raise ValueError(
                "energies were not followed: make the solid with Solid(.., energies=True)"
            )
        return self.densities.by_body(self.fields)

    def max(self, name: str) -> float:
        """Return the largest value of a scalar field over all integration points (collective).

        Args:
            name: see `PointFields.values`, for example "von_mises" or "plastic_strain_norm".

        Raises:
            ValueError: for a tensor, or a name that no law knows.
        """
        return self.fields.max(name)

    def cell_values(self, name: str) -> fem.Function:
        """Return the cell averages of a field as a DG0 Function (refilled at every call)."""
        return self.fields.cell_values(name)

    def output_fields(self) -> dict[str, fem.Function]:
        """Return the cell averages worth writing, by name, in the user's units (collective).

        Stress, internal variables and the laws' own output, all of the last `evaluate`.
        ``plastic_strain_norm`` and ``back_stress_norm`` are tensor (Frobenius) norms, ``hardening``
        is the vector norm of the stored back stress components that the literature plots.
        """
        first = [name for name in OUTPUT_FIELDS if name in self.fields.names]
        return {
            name: self.cell_values(name) for name in dict.fromkeys([*first, *self.fields.bases])
        }

    def plastic_area(self) -> float:
        """Return the area (volume of spatial bodies and rings) whose plastic strain is not zero.

        A law whose `output` has a field ``plastic``, one or zero, says itself where it is.
        """
        return self.fields.integral("plastic") if "plastic" in self.fields.names else 0.0


def _degree(V: fem.FunctionSpace, given: int | None) -> int:
    """Return the quadrature degree: by default 2(p - 1) >= 1 on simplices, else 2p."""
    if given is not None:
        rule = integer(0, HIGHEST_RULE)
        return check("quadrature_degree", given, rule, f"{rule.remedy}, or None")
    p = V.element.basix_element.degree
    simplex = V.mesh.topology.cell_type in (CellType.triangle, CellType.tetrahedron)
    return max(2 * (p - 1), 1) if simplex else 2 * p
