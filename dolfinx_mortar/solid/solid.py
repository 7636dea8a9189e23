# SPDX-License-Identifier: MIT
"""The bodies: materials on cell tags, committed state, energy, residual and tangent.

Everything is compiled and allocated when a `Solid` is made (what only serves output: when first
asked for). The compiled code depends on the cell type and the laws, not on the mesh, the tags or
the values of the parameters, which live in cell-wise constant Functions.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cached_property
from types import SimpleNamespace
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

import basix.ufl
import ufl
from dolfinx import fem, la, mesh
from dolfinx.fem import petsc as fem_petsc
from dolfinx_mortar import compat
from dolfinx_mortar.algebra.parallel import any_rank
from dolfinx_mortar.materials import Material
from dolfinx_mortar.materials.tensor import COMPONENTS, from_components, strain, to_components
from dolfinx_mortar.solid.laws import Region, check_displacement, create_regions
from dolfinx_mortar.solid.points import PointFields
from ufl.classes import Label, Variable

OUTPUT_FIELDS = (
    *("stress", "von_mises", "plastic_strain", "plastic_strain_norm"),
    *("back_stress_norm", "hardening"),
)


class Solid:
    """Elasto-plastic bodies on one mesh, seen from the displacement u and the committed state.

    Attributes:
        u: displacement; its ghosts must be up to date in every call.
        V: space of u.
        state: committed internal variables by name, quadrature Functions. Tensors are stored as
            (xx, yy, zz, xy) in 2D (plane strain) and (xx, yy, zz, xy, yz, xz) in 3D, the shear
            being the tensor component.
        stress: quadrature Function of the same components, filled by `update_output`.
        quadrature_degree: degree of the cell integrals.
        linear: True if all laws are linear, so that the tangent is constant.
        has_energy: True if all laws have a potential, so that `energy` works.
    """

    def __init__(
        self,
        u: fem.Function,
        materials: Material | Mapping[int, Material],
        cell_tags: mesh.MeshTags | None = None,
        *,
        quadrature_degree: int | None = None,
    ) -> None:
        """Create the bodies and compile their forms (collective).

        Args:
            u: displacement, a vector Lagrange Function of degree 1.
            materials: one law for all cells, or a law per cell tag.
            cell_tags: tags of the cells; needed with a law per tag.
            quadrature_degree: None means 2(p - 1), at least 1, on simplices and 2p on
                quadrilaterals and hexahedra, p the degree of u.

        Raises:
            ValueError: if u is in another kind of space, materials and tags do not match, or the
                quadrature degree is no integer from 0 on.
        """
        check_displacement(u)
        self.u = u
        self.V = u.function_space
        self.mesh = self.V.mesh
        self.quadrature_degree = _degree(self.V, quadrature_degree)
        self.regions = create_regions(self.mesh, materials, cell_tags)
        self.linear = all(r.law.linear for r in self.regions)
        self.state = self._create_state()
        self._staged = {name: fem.Function(f.function_space) for name, f in self.state.items()}
        self.stress = self._create_quadrature_function((3, 3), "stress")
        self._compile()

    # -- set-up ---------------------------------------------------------------------------------

    def _create_quadrature_function(self, shape: tuple[int, ...], name: str) -> fem.Function:
        """Create a quadrature Function for a scalar, shape (), or a tensor, shape (3, 3)."""
        value_shape = (len(COMPONENTS[self.mesh.geometry.dim]),) if shape else ()
        element = basix.ufl.quadrature_element(
            self.mesh.basix_cell(),
            value_shape=value_shape,
            scheme="default",
            degree=self.quadrature_degree,
        )
        return fem.Function(fem.functionspace(self.mesh, element), name=name)

    def _create_state(self) -> dict[str, fem.Function]:
        """Create the internal variables of all laws, shared where laws use the same name."""
        shapes: dict[str, tuple[int, ...]] = {}
        for region in self.regions:
            for name, shape in region.law.state.items():
                assert shapes.setdefault(name, shape) == shape, f"two shapes of state {name}"
        return {n: self._create_quadrature_function(s, n) for n, s in shapes.items()}

    def _symbols(self, region: Region) -> tuple[dict[str, Any], SimpleNamespace]:
        """Return state and parameters of a region as UFL."""
        state = {
            name: from_components(self.state[name]) if shape else self.state[name]
            for name, shape in region.law.state.items()
        }
        return state, region.symbols

    def _stress(self, region: Region, eps: Any) -> Any:
        """Return the stress of a region's law as UFL, from the law or from its potential."""
        state, p = self._symbols(region)
        if hasattr(region.law, "stress"):
            return region.law.stress(eps, state, p)
        # Not ufl.variable: its running number would get into the signature of the compiled code.
        variable = Variable(eps, Label(-1))
        return ufl.diff(region.law.energy(variable, state, p), variable)

    def _measures(self) -> list[tuple[Region, ufl.Measure]]:
        """Return each region with the measure of its cells."""
        metadata = {"quadrature_degree": self.quadrature_degree, "quadrature_scheme": "default"}
        dx = ufl.Measure("dx", self.mesh, metadata=metadata)
        if len(self.regions) == 1:
            return [(self.regions[0], dx)]
        owned = self.mesh.topology.index_map(self.mesh.topology.dim).size_local
        # Numbers of the laws, not the user's tags: tags must not enter the compiled code.
        domains = [(i, r.cells[r.cells < owned]) for i, r in enumerate(self.regions)]
        dx = dx(subdomain_data=domains)
        return [(region, dx(i)) for i, region in enumerate(self.regions)]

    def _compile(self) -> None:
        """Compile all forms and expressions that a Newton step needs."""
        v, w = ufl.TestFunction(self.V), ufl.TrialFunction(self.V)
        self._direction = fem.Function(self.V)
        self._force = la.vector(self.V.dofmap.index_map, self.V.dofmap.bs)
        eps, virtual, along = strain(self.u), strain(v), strain(self._direction)
        measures = self._measures()
        stress = [self._stress(region, eps) for region in self.regions]
        residual = sum(
            ufl.inner(s, virtual) * dx for s, (_, dx) in zip(stress, measures, strict=True)
        )
        norm = sum(
            ufl.inner(r.law.elastic_stress(along, r.symbols), along) * dx for r, dx in measures
        )
        gram = _gradient_gram(self.V)
        force = sum(
            _element_force(s, gram) * dx for s, (_, dx) in zip(stress, measures, strict=True)
        )
        self._residual = fem.form(residual)
        self._tangent = fem.form(ufl.derivative(residual, self.u, w))
        self._norm = fem.form(norm)
        self._element_force = fem.form(force)
        self._energy = None
        if all(hasattr(region.law, "energy") for region in self.regions):
            psi = [region.law.energy(eps, *self._symbols(region)) for region in self.regions]
            self._energy = fem.form(sum(e * dx for e, (_, dx) in zip(psi, measures, strict=True)))
        self._updates = [
            (name, region.cells, self._expression(value))
            for region in self.regions
            for name, value in self._updated_state(region, eps).items()
        ]

    def _updated_state(self, region: Region, eps: Any) -> dict[str, Any]:
        """Return the new internal variables of a region as UFL components."""
        new = region.law.updated_state(eps, *self._symbols(region))
        size = len(COMPONENTS[self.mesh.geometry.dim])
        return {n: to_components(t, size) if t.ufl_shape else t for n, t in new.items()}

    def _expression(self, value: Any) -> fem.Expression:
        """Compile a UFL expression for all integration points."""
        return fem.Expression(value, compat.interpolation_points(self.stress.function_space))

    # -- one Newton iteration -------------------------------------------------------------------

    def create_matrix(self) -> PETSc.Mat:
        """Create the matrix of the tangent: V's layout, pattern of the mesh, no entries."""
        K = fem_petsc.create_matrix(self._tangent)
        K.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        return K

    def assemble_tangent(self, K: PETSc.Mat) -> None:
        """Fill K with the consistent tangent dF/du at u, symmetric, without boundary conditions."""
        K.zeroEntries()
        fem_petsc.assemble_matrix(K, self._tangent)
        K.assemble()

    def assemble_residual(self, r: PETSc.Vec) -> None:
        """Fill the owned part of r with the internal forces F(u)_i = int sigma : eps(phi_i)."""
        self._force.array[:] = 0.0
        fem.assemble_vector(self._force.array, self._residual)
        self._force.scatter_reverse(la.InsertMode.add)
        r.array_w[:] = self._force.array[: r.local_size]

    @property
    def has_energy(self) -> bool:
        """Whether all laws have a potential."""
        return self._energy is not None

    def energy(self) -> float:
        """Return the incremental potential Psi(u), the sum over all ranks.

        Raises:
            ValueError: if a law gives a stress but no potential.
        """
        if self._energy is None:
            raise ValueError("Solid.energy: a material gives a stress but no energy.")
        return self._sum(self._energy)

    def elastic_norm(self, v: fem.Function) -> float:
        """Return the energy norm sqrt(int eps(v) : C : eps(v)) of a Function of V."""
        self._direction.x.array[:] = v.x.array
        return math.sqrt(max(self._sum(self._norm), 0.0))

    def element_force_norm(self) -> float:
        """Return the norm of the unassembled element forces at u, sqrt(sum_e sum_a |f_ea|^2).

        This is the scale of round-off in F(u), and does not vanish with residual stresses. Exact
        for degree 1 on simplices; on other cells the gradients at the midpoint are used.
        """
        return math.sqrt(max(self._sum(self._element_force), 0.0))

    def _sum(self, form: fem.Form) -> float:
        """Assemble a scalar over all ranks."""
        return self.mesh.comm.allreduce(fem.assemble_scalar(form), op=MPI.SUM)

    # -- committed state and output -------------------------------------------------------------

    def commit(self) -> None:
        """Make the state at the current u the committed one (all internal variables at once)."""
        for name, cells, expression in self._updates:
            self._staged[name].interpolate(expression, cells)
        for name, staged in self._staged.items():
            self.state[name].x.array[:] = staged.x.array

    def update_output(self) -> None:
        """Evaluate the stress at u and the committed state; call after `commit`."""
        for region, expression in zip(self.regions, self._stress_expressions, strict=True):
            self.stress.interpolate(expression, region.cells)

    @cached_property
    def _stress_expressions(self) -> list[fem.Expression]:
        """Expressions of the stress per region, compiled at the first output."""
        size = len(COMPONENTS[self.mesh.geometry.dim])
        stresses = [self._stress(region, strain(self.u)) for region in self.regions]
        return [self._expression(to_components(s, size)) for s in stresses]

    @cached_property
    def fields(self) -> PointFields:
        """Stress, state and what derives from them at the integration points, as arrays."""
        return PointFields(self.stress, self.state, self.regions, self.quadrature_degree)

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

        The committed stress and internal variables as far as the laws have them.
        ``plastic_strain_norm`` and ``back_stress_norm`` are tensor (Frobenius) norms, ``hardening``
        is the vector norm of the stored back stress components that the literature plots.
        """
        return {n: self.cell_values(n) for n in OUTPUT_FIELDS if n in self.fields.names}

    def plastic_area(self) -> float:
        """Return the area (volume in 3D) whose committed plastic strain is not zero."""
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


def _gradient_gram(V: fem.FunctionSpace) -> np.ndarray:
    """Return sum_a grad N_a (x) grad N_a at the midpoint of the reference cell, times its volume.

    Shape (d, d); the gradients are those of the reference cell.
    """
    element = V.element.basix_element
    d = V.mesh.topology.dim
    midpoint, weight = map(np.asarray, basix.make_quadrature(element.cell_type, 1))
    gradients = element.tabulate(1, midpoint)[1:, 0, :, 0].reshape(d, -1)
    return float(weight[0]) * gradients @ gradients.T


def _element_force(stress: Any, gram: np.ndarray) -> Any:
    """Return the density of sum_a |f_ea|^2 over a cell, f_ea = sigma . grad N_a |cell|."""
    domain = ufl.domain.extract_unique_domain(stress)
    d = gram.shape[0]
    s = ufl.as_tensor([[stress[i, j] for j in range(d)] for i in range(d)])
    t = s * ufl.transpose(ufl.JacobianInverse(domain))
    return abs(ufl.JacobianDeterminant(domain)) * ufl.inner(t * ufl.as_matrix(gram.tolist()), t)
