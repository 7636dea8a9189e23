# SPDX-License-Identifier: MIT
"""The bodies: materials on cell tags, committed state, energy, residual and tangent.

A step ends with `evaluate`, which shows its results, and is accepted by `commit`.

Everything that a step needs is compiled and allocated when a `Solid` is made; only the weights of
integration points and averages over cells, which serve output and messages, when first asked for.
The compiled code depends on the cell type and the laws, not on the mesh, the tags or the values of
the parameters, which live in cell-wise constant Functions.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from dolfinx import fem, la, mesh
from dolfinx.fem import petsc as fem_petsc
from dolfinx_mortar.algebra.errors import raised_together
from dolfinx_mortar.algebra.parallel import any_rank
from dolfinx_mortar.arrays import Bools
from dolfinx_mortar.materials import Material
from dolfinx_mortar.solid.forms import create_forms, create_responses
from dolfinx_mortar.solid.kinematics import Kinematics, kinematics_of_dimension
from dolfinx_mortar.solid.laws import create_regions
from dolfinx_mortar.solid.points import PointFields
from dolfinx_mortar.solid.state import (
    create_evaluations,
    create_field,
    create_state,
    fill_all,
)
from dolfinx_mortar.spaces import check_space

# Written first, and if a law has them; then all internal variables and what the laws put out.
OUTPUT_FIELDS = (
    *("stress", "von_mises", "plastic_strain", "plastic_strain_norm"),
    *("back_stress_norm", "hardening"),
)


class Solid:
    """Elasto-plastic bodies on one mesh, seen from the displacement u and the committed state.

    Attributes:
        u: displacement; its ghosts must be up to date in every call.
        V: space of u.
        kinematics: strain measure, weight and rigid motions; plane strain in 2D.
        state: committed internal variables by name, quadrature Functions: those from which the
            next step starts. What `fields` and `max` show is the state that `evaluate` found,
            committed or not. Tensors are stored as (xx, yy, zz, xy) in 2D (plane strain) and
            (xx, yy, zz, xy, yz, xz) in 3D, the shear being the tensor component.
        stress: quadrature Function of the same components, filled by `evaluate`.
        quadrature_degree: degree of the cell integrals.
        regions: the cells of each law, with its parameters.
        fields: what `evaluate` found, at the integration points.
    """

    def __init__(
        self,
        u: fem.Function,
        materials: Material | Mapping[int, Material],
        cell_tags: mesh.MeshTags | None = None,
        *,
        quadrature_degree: int | None = None,
        kinematics: Kinematics | None = None,
    ) -> None:
        """Create the bodies and compile their forms (collective).

        Args:
            u: displacement, a vector Lagrange Function of degree 1.
            materials: one law for all cells, or a law per cell tag.
            cell_tags: tags of the cells; needed with a law per tag.
            quadrature_degree: None means 2(p - 1), at least 1, on simplices and 2p on
                quadrilaterals and hexahedra, p the degree of u.
            kinematics: None means plane strain in 2D, spatial in 3D.

        Raises:
            ValueError: if u is in another kind of space, materials and tags do not match, the
                quadrature degree is no integer from 0 on, or a law lacks a part, raises, or returns
                something of the wrong name or shape; the message names the law and the part.
        """
        if not isinstance(u, fem.Function):
            raise ValueError(f"u must be a dolfinx.fem.Function (the displacement), not {type(u)}.")
        check_space(u.function_space, "u")
        self.u = u
        self.V = u.function_space
        self.kinematics = kinematics or kinematics_of_dimension(self.mesh.geometry.dim)
        self.quadrature_degree = _degree(self.V, quadrature_degree)
        self.regions = create_regions(self.mesh, materials, cell_tags)
        self.state = create_state(self.regions, self.mesh, self.quadrature_degree)
        self._staged = {name: f.copy() for name, f in self.state.items()}
        self.stress = create_field(self.mesh, self.quadrature_degree, (3, 3), "stress")
        responses = create_responses(u, self.regions, self.state, self.kinematics)
        weight = self.kinematics.weight
        self.fields = PointFields(
            self.stress, self._staged, self.regions, self.quadrature_degree, weight
        )
        with raised_together(self.mesh.comm):
            self.fields.bases  # noqa: B018 - judges what the laws put out
        self._forms = create_forms(
            u, self.regions, responses, self.kinematics, self.quadrature_degree
        )
        self._evaluations = create_evaluations(self.regions, responses, self._staged, self.stress)

    @property
    def mesh(self) -> mesh.Mesh:
        """The mesh of all bodies."""
        return self.V.mesh

    @property
    def linear(self) -> bool:
        """Whether all laws are linear, so that the tangent is constant."""
        return all(region.law.linear for region in self.regions)

    @property
    def has_energy(self) -> bool:
        """Whether all laws have a potential, so that `energy` works."""
        return self._forms.energy is not None

    # -- one Newton iteration -------------------------------------------------------------------

    def create_matrix(self) -> PETSc.Mat:
        """Create the matrix of the tangent: V's layout, pattern of the mesh, no entries."""
        K = fem_petsc.create_matrix(self._forms.tangent)
        K.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        return K

    def assemble_tangent(self, K: PETSc.Mat) -> None:
        """Fill K with the consistent tangent dF/du at u, symmetric, without boundary conditions."""
        K.zeroEntries()
        fem_petsc.assemble_matrix(K, self._forms.tangent)
        K.assemble()

    def assemble_residual(self, r: PETSc.Vec) -> None:
        """Fill the owned part of r with the internal forces F(u)_i = int sigma : eps(phi_i)."""
        force = self._forms.force
        force.array[:] = 0.0
        fem.assemble_vector(force.array, self._forms.residual)
        force.scatter_reverse(la.InsertMode.add)
        r.array_w[:] = force.array[: r.local_size]

    def energy(self) -> float:
        """Return the incremental potential Psi(u), the sum over all ranks.

        Raises:
            ValueError: if a law gives a stress but no potential.
        """
        if self._forms.energy is None:
            raise ValueError("Solid.energy: a material gives a stress but no energy.")
        return self._sum(self._forms.energy)

    def elastic_norm(self, v: fem.Function) -> float:
        """Return the energy norm sqrt(int eps(v) : C : eps(v)) of a Function of V."""
        self._forms.direction.x.array[:] = v.x.array
        return math.sqrt(max(self._sum(self._forms.elastic_norm), 0.0))

    def element_force_norm(self) -> float:
        """Return the norm of the unassembled element forces at u, sqrt(sum_e sum_a |f_ea|^2).

        This is the scale of round-off in F(u), and does not vanish with residual stresses. Exact
        for degree 1 on simplices; on other cells the gradients at the midpoint are used.
        """
        return math.sqrt(max(self._sum(self._forms.element_force), 0.0))

    def _sum(self, form: fem.Form) -> float:
        """Assemble a scalar over all ranks."""
        return self.mesh.comm.allreduce(fem.assemble_scalar(form), op=MPI.SUM)

    # -- results and committed state ------------------------------------------------------------

    def evaluate(self) -> None:
        """Evaluate stress and internal variables at u and the committed state; collective.

        These are the results of the step whose displacement is u: `stress`, `fields` and all that
        rests on them show them from now on. The committed state stays as it is.

        Raises:
            ValueError: on all ranks, if a law gives NaN or infinity on any; the message names it.
                All that is shown, and what `commit` would take, is then as before.
        """
        fill_all(self.mesh.comm, self._evaluations)

    def evaluate_again(self) -> None:
        """Evaluate at a displacement that was judged before; without communication."""
        for evaluation in self._evaluations:
            evaluation.fill()

    def commit(self) -> None:
        """Make the internal variables that `evaluate` found last those of the next step's start.

        Nothing that is shown changes.
        """
        for name, staged in self._staged.items():
            self.state[name].x.array[:] = staged.x.array

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
        """Return the area (volume in 3D) whose plastic strain is not zero, whatever the law.

        A law whose `output` has a field ``plastic``, one or zero, says itself where it is.
        """
        return self.fields.integral("plastic") if "plastic" in self.fields.names else 0.0


def _degree(V: fem.FunctionSpace, given: int | None) -> int:
    """Return the quadrature degree: by default 2(p - 1) >= 1 on simplices, else 2p."""
    if given is not None:
        valid = isinstance(given, int | np.integer) and not isinstance(given, bool) and given >= 0
        if any_rank(V.mesh.comm, not valid)[0]:
            raise ValueError(f"quadrature_degree is {given!r}: give an integer from 0 on, or None.")
        return int(given)
    p = V.element.basix_element.degree
    simplex = V.mesh.topology.cell_type in (mesh.CellType.triangle, mesh.CellType.tetrahedron)
    return max(2 * (p - 1), 1) if simplex else 2 * p
