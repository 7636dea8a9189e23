# SPDX-License-Identifier: MIT
"""Energy, internal forces and tangent of the bodies as compiled forms."""

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cached_property

from petsc4py import PETSc

import numpy as np

import basix
import ufl
from dolfinx import default_scalar_type, fem
from dolfinx.jit import get_options
from dolfinx_mortar.algebra.parallel import raised_together
from dolfinx_mortar.common.arrays import Floats
from dolfinx_mortar.materials.protocol import Law
from dolfinx_mortar.materials.response import Response, elastic_response, respond
from dolfinx_mortar.materials.tensor import GRADIENT, contract
from dolfinx_mortar.solid.kinematics import Kinematics
from dolfinx_mortar.solid.laws import Eigenstrain, Integral, Region
from dolfinx_mortar.solid.mean_volume import MeanVolume
from dolfinx_mortar.solid.pointwise import PointValuesOfRegion
from dolfinx_mortar.solid.sources import unchanged
from dolfinx_mortar.solid.term import MatrixForm, create_vector
from ufl.core.expr import Expr

REASSOCIATE = (
    *("-fassociative-math", "-fno-signed-zeros", "-fno-trapping-math"),
    "-funroll-loops",
)
"""Lets the compiler take the sums of a tangent in any order, several at once. Infinity and NaN stay
what they are. Assembly on hexahedra, tetrahedra, quadrilaterals: .60, .91, .94 of the time."""


def in_any_order() -> dict[str, list[str]]:
    """Compiler options for tangents: the user's, and `REASSOCIATE`."""
    return {"cffi_extra_compile_args": [*get_options()["cffi_extra_compile_args"], *REASSOCIATE]}


def unrolled(cell: str) -> list[str]:
    """Compiler options for other forms: -O3 on tensor-product cells."""
    given = get_options()["cffi_extra_compile_args"]
    if cell not in ("quadrilateral", "hexahedron") or "-O2" not in given:
        return list(given)
    return [*("-O3" if option == "-O2" else option for option in given), "-fno-trapping-math"]


class Forms:
    """Compiled forms of a solid, with the two vectors that they read or fill.

    Attributes:
        residual: int sigma : d eps/du [v].
        tangent: its derivative.
        elastic_norm: int eps(w) : C : eps(w), w = `direction`.
        element_force: sum_e sum_a |f_ea|^2.
        energy: Psi, if all laws have a potential.
        force: the residual with its ghosts.
        dilatation: the reduced volumetric part, not among these forms.
        committed: data of the stress of the committed state.
    """

    def __init__(
        self,
        u: fem.Function,
        responses: Sequence[Response],
        integral: Integral,
        dilatation: MeanVolume | None,
        eigenstrain: Eigenstrain | None,
    ) -> None:
        """Compile all forms of a Newton step; collective."""
        self._u, self._integral, self.dilatation = u, integral, dilatation
        self.committed = CommittedData(u, responses, integral, eigenstrain)
        V, regions, kinematics = u.function_space, integral.regions, integral.kinematics
        self.direction, self.force = fem.Function(V), create_vector(V)
        virtual = kinematics.virtual(u, ufl.TestFunction(V))
        along = _unturned(kinematics, u, self.direction)
        along = along if dilatation is None else ufl.dev(along)
        residual = integral(ufl.inner(r.stress, virtual) for r in responses)
        entries = GRADIENT[V.mesh.geometry.dim]
        by_moduli = [
            moduli_first(response, entries) if _from_energy(region.law) else response
            for region, response in zip(regions, responses, strict=True)
        ]
        tangent = _tangent(u, by_moduli, kinematics, integral)
        with raised_together(V.mesh.comm):
            elastic = [ufl.inner(elastic_response(r.law, along, r.symbols), along) for r in regions]
        scale = integral(integral.weight * _element_force(V, r.stress) for r in responses)
        energies = [r.energy for r in responses if r.energy is not None]
        together = [residual, integral(elastic), scale]
        together += [integral(energies)] if len(energies) == len(regions) else []
        options = {"cffi_extra_compile_args": unrolled(V.mesh.topology.cell_name())}
        self.residual, self.elastic_norm, self.element_force, *energy = fem.form(
            together, jit_options=options
        )
        self.energy: fem.Form | None = energy[0] if energy else None
        self.tangent = MatrixForm(fem.form(tangent, jit_options=in_any_order()))

    def add_elastic(self, K: PETSc.Mat, factor: float) -> None:
        """Add a multiple of the positive stiffness of `elastic_norm`; collective."""
        form, share = self._elastic
        share.value = factor
        form.add_to(K)
        K.assemble()

    @cached_property
    def _elastic(self) -> tuple[MatrixForm, fem.Constant]:
        V, kinematics = self._u.function_space, self._integral.kinematics
        factor = fem.Constant(V.mesh, default_scalar_type(1.0))
        of_v, of_w = (
            _unturned(kinematics, self._u, f(V)) for f in (ufl.TestFunction, ufl.TrialFunction)
        )
        stresses = (elastic_response(r.law, of_w, r.symbols) for r in self._integral.regions)
        form = self._integral(factor * ufl.inner(stress, of_v) for stress in stresses)
        return MatrixForm(fem.form(form)), factor

    @cached_property
    def moduli(self) -> float:
        """Integral (this rank) of |C : (e_x e_y + e_y e_x)|, an energy."""
        shear = ufl.as_tensor([[0, 1, 0], [1, 0, 0], [0, 0, 0]])
        integral = dataclasses.replace(self._integral, degree=1)
        moduli = [elastic_response(r.law, shear, r.symbols) for r in integral.regions]
        return float(
            fem.assemble_scalar(fem.form(integral(ufl.sqrt(ufl.inner(C, C)) for C in moduli)))
        )


class CommittedData:
    """Committed displacement, eigenstrain and parameters."""

    def __init__(
        self,
        u: fem.Function,
        responses: Sequence[Response],
        integral: Integral,
        eigenstrain: Eigenstrain | None,
    ) -> None:
        """Start from X, without eigenstrain, with the present parameters."""
        self._u, self._responses, self._integral = u, responses, integral
        self._eigenstrain = eigenstrain
        self.strained = [u] if eigenstrain is None else [u, eigenstrain.function]
        varying = [region.function for region in integral.regions if region.varying]
        self._functions = [*self.strained, *varying]
        self._kept: list[Floats] | None = None
        for values in self.complete()[: len(self.strained)]:
            values[:] = 0.0

    def forget(self) -> None:
        """Take the values of the next `complete`, as committed ones."""
        self._kept = None

    def complete(self) -> list[Floats]:
        """The committed values, or the present ones if unknown."""
        if self._kept is None:
            self._kept = [f.x.array.copy() for f in self._functions]
        return self._kept

    def differ(self) -> list[bool]:
        """Whether present values on this rank differ, of each Function, u the first."""
        now = [f.x.array for f in self._functions]
        return [not np.array_equal(*pair) for pair in zip(now, self.complete(), strict=True)]

    @cached_property
    def change(self) -> tuple[fem.Form, list[fem.Function]]:
        """Form int C : (eps(w) - e) : eps(v), at finite strain C : (-F_e e) : dF[v], and w, e."""
        V, kinematics = self._u.function_space, self._integral.kinematics
        changes, v = [fem.Function(V)], ufl.TestFunction(V)
        strain, virtual = (kinematics.virtual(self._u, along) for along in (changes[0], v))
        if (eigen := self._eigenstrain) is not None:
            changes.append(eigen.function.copy())
            by = eigen.tensor_of(changes[1])
            whole = kinematics.measure(self._u)
            strain = -whole * eigen.inverse * by if kinematics.finite else strain - by
        densities = (ufl.inner(r.change(strain), virtual) for r in self._responses)
        return fem.form(self._integral(densities)), changes

    @contextmanager
    def put(self) -> Iterator[None]:
        """Restore the committed values, at finite strain not of u, within a block."""
        first = int(self._integral.kinematics.finite)
        with unchanged(self._functions):
            for f, values in zip(self._functions[first:], self.complete()[first:], strict=True):
                f.x.array[:] = values
            yield


def create_responses(
    regions: Sequence[Region],
    strain: Expr,
    state: Mapping[str, fem.Function],
    found: Mapping[Law, PointValuesOfRegion],
) -> list[Response]:
    """Response of each region to a 3x3 strain, in UFL; a ValueError on all ranks; collective."""
    responses = []
    with raised_together(regions[0].mesh.comm):
        for region in regions:
            if region.law in found:
                responses.append(found[region.law].response)
            else:
                committed = region.tensors(state)
                responses.append(respond(region.law, strain, committed, region.symbols))
    return responses


def _unturned(kinematics: Kinematics, u: fem.Function, v: Expr) -> Expr:
    """Strain of v at u, zero for rotations of the deformed body."""
    along = kinematics.virtual(u, v)
    return ufl.sym(ufl.transpose(kinematics.measure(u)) * along) if kinematics.finite else along


def _from_energy(law: Law) -> bool:
    derived = not law.at_points and law.stress is None and law.tangent is None
    return derived and law.strain == "finite"


def moduli_first(response: Response, entries: Sequence[tuple[int, int]]) -> Response:
    """Response with a symmetric dP/dF, formed once, times the direction."""

    def change(direction: Expr) -> Expr:
        columns = []
        for entry in entries:
            unit = [[1.0 if (i, j) == entry else 0.0 for j in range(3)] for i in range(3)]
            columns.append(response.change(ufl.as_tensor(unit)))
        return contract(entries, lambda a, b: columns[b][entries[a]], direction, symmetric=False)

    return dataclasses.replace(response, change=change)


def _tangent(
    u: fem.Function, responses: Sequence[Response], kinematics: Kinematics, integral: Integral
) -> ufl.Form:
    V = u.function_space
    v, w = ufl.TestFunction(V), ufl.TrialFunction(V)
    virtual, along = kinematics.virtual(u, v), kinematics.virtual(u, w)
    linear = kinematics.linear_in(u)
    densities = []
    with raised_together(V.mesh.comm):
        for response in responses:
            change = ufl.inner(response.change(along), virtual)
            if not linear:
                change += ufl.inner(response.stress, ufl.derivative(virtual, u, w))
            densities.append(change)
    return integral(densities)


def _element_force(V: fem.FunctionSpace, stress: Expr) -> Expr:
    """Density of sum_a |f_ea|^2 over a cell, f_ea = sigma . grad N_a |cell| at its midpoint."""
    element, domain = V.element.basix_element, V.mesh.ufl_domain()
    d = V.mesh.topology.dim
    midpoint, (weight,) = map(np.asarray, basix.make_quadrature(element.cell_type, 1))
    gradients = element.tabulate(1, midpoint)[1:, 0, :, 0].reshape(d, -1)
    gram = weight * gradients @ gradients.T
    s = ufl.as_tensor([[stress[i, j] for j in range(d)] for i in range(d)])
    t = s * ufl.transpose(ufl.JacobianInverse(domain))
    return abs(ufl.JacobianDeterminant(domain)) * ufl.inner(t * ufl.as_matrix(gram.tolist()), t)
