# SPDX-License-Identifier: MIT
"""Energy, internal forces and tangent of the bodies as compiled forms."""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import reduce
from operator import add
from typing import Any

import numpy as np

import basix
import ufl
from dolfinx import default_scalar_type, fem, la
from dolfinx.jit import get_options
from dolfinx_mortar import compat
from dolfinx_mortar.algebra.errors import raised_together
from dolfinx_mortar.arrays import Floats
from dolfinx_mortar.materials.protocol import Law
from dolfinx_mortar.materials.response import Response, elastic_response, respond
from dolfinx_mortar.materials.tensor import GRADIENT
from dolfinx_mortar.solid.committed_data import CommittedData
from dolfinx_mortar.solid.dilatation import MeanDilatation
from dolfinx_mortar.solid.eigenstrain import Eigenstrain
from dolfinx_mortar.solid.kinematics import Kinematics
from dolfinx_mortar.solid.laws import Region, measures
from dolfinx_mortar.solid.mean_volume import MeanVolume
from dolfinx_mortar.solid.pointwise import PointValuesOfRegion
from dolfinx_mortar.solid.sources import Source
from dolfinx_mortar.solid.state import as_tensors
from dolfinx_mortar.solid.term import MatrixForm, create_vector
from ufl.core.expr import Expr

REASSOCIATE = (
    *("-fassociative-math", "-fno-signed-zeros", "-fno-trapping-math"),
    "-funroll-loops",
)
"""Lets the compiler take the sums of a tangent in any order, several at once: Newton's method asks
for no more, while residuals and energies are compiled as they are written. Infinity and NaN stay
what they are. Measured, assembly on hexahedra, tetrahedra, quadrilaterals: .70, .89, .97 of the
time. Unrolled loops over functions take .86, 1.02, .97 of that, of second order .97, .90, .91."""


def in_any_order() -> dict[str, list[str]]:
    """Return the compiler's options for tangents: those that are set, and `REASSOCIATE`."""
    return {"cffi_extra_compile_args": [*get_options()["cffi_extra_compile_args"], *REASSOCIATE]}


def unrolled(cell: str) -> list[str]:
    """Return the compiler's options for residual, norms and energy: those that are set.

    On cells of products -O2 becomes -O3, which unrolls loops over functions and takes two points at
    once, with the same bits. Measured, an integral of elastic bodies, energy on quadrilaterals and
    hexahedra .73 and .57 of the time, residual 1.14 and 1.04; energy on triangles 1.39.
    """
    given = get_options()["cffi_extra_compile_args"]
    if cell not in ("quadrilateral", "hexahedron") or "-O2" not in given:
        return list(given)
    return [*("-O3" if option == "-O2" else option for option in given), "-fno-trapping-math"]


@dataclass(frozen=True)
class Forms:
    """What is compiled for a solid, with the two vectors that forms read or fill."""

    residual: fem.Form  # int sigma : d eps/du [v]
    tangent: MatrixForm  # its derivative
    elastic_norm: fem.Form  # int eps(w) : C : eps(w), w = direction
    element_force: fem.Form  # sum_e sum_a |f_ea|^2
    energy: fem.Form | None  # Psi, if all laws have a potential
    direction: fem.Function  # argument of elastic_norm
    force: la.Vector  # the residual with its ghosts
    dilatation: (
        MeanDilatation | MeanVolume | None
    )  # what tangent, elastic_norm and energy leave out
    evaluations: Sequence[Source]  # of stress and new internal variables at the points
    found: Mapping[Law, PointValuesOfRegion]  # at the points before each assembly
    committed: CommittedData  # what the stress of the committed state rests on


def create_responses(
    strain: Expr,
    regions: Sequence[Region],
    state: Mapping[str, fem.Function],
    found: Mapping[Law, PointValuesOfRegion],
    mean_stress: fem.Function | None = None,
) -> list[Response]:
    """Return the response of the law of each region to a 3x3 strain, as UFL; collective.

    With a mean stress per cell the strain is a deviator, and the energies leave out the volumetric
    part. What is `found` at points before each assembly comes with its response.

    Raises:
        ValueError: on all ranks, if a law raises or returns something wrong on any.
    """
    responses = []
    with raised_together(regions[0].parameters.function.function_space.mesh.comm):
        for region in regions:
            if region.law in found:
                response = found[region.law].response
            else:
                committed = as_tensors(region, state)
                response = respond(region.law, strain, committed, region.symbols)
            responses.append(response if mean_stress is None else _split(response, mean_stress))
    return responses


def _split(response: Response, mean_stress: fem.Function) -> Response:
    """Return the response to a deviator, with the mean stress and a tangent that sees no trace."""
    return dataclasses.replace(
        response,
        stress=response.stress + mean_stress * ufl.Identity(3),
        change=lambda direction: response.change(ufl.dev(direction)),
    )


def create_forms(
    u: fem.Function,
    regions: Sequence[Region],
    responses: Sequence[Response],
    kinematics: Kinematics,
    degree: int,
    *,
    points: tuple[Sequence[Source], Mapping[Law, PointValuesOfRegion]],
    dilatation: MeanDilatation | MeanVolume | None = None,
    committed: CommittedData,
) -> Forms:
    """Compile all forms that a Newton step needs; collective.

    The weak form F(u; v) = int sigma(eps) : d eps/du [v], its derivative, the potential, and the
    two norms that scale residuals. With a dilatation they leave out the volumetric part. The points
    are what evaluates stress and state there, and what is found before each assembly.
    """
    V = u.function_space
    parts = measures(V, regions, degree)
    weight = ufl.as_ufl(kinematics.weight(ufl.SpatialCoordinate(V.mesh)))
    v, direction = ufl.TestFunction(V), fem.Function(V)
    virtual, along = kinematics.virtual(u, v), _unturned(kinematics, u, direction)
    along = along if dilatation is None else ufl.dev(along)

    def integral(densities: Sequence[Expr]) -> ufl.Form:
        pairs = zip(densities, parts, strict=True)
        return reduce(add, (weight * density * dx for density, dx in pairs))

    residual = integral([ufl.inner(r.stress, virtual) for r in responses])
    entries = GRADIENT[V.mesh.geometry.dim]
    by_moduli = [
        moduli_first(response, entries) if _from_energy(region.law) else response
        for region, response in zip(regions, responses, strict=True)
    ]
    tangent = _tangent(u, by_moduli, kinematics, integral)
    with raised_together(V.mesh.comm):
        elastic = [ufl.inner(elastic_response(r.law, along, r.symbols), along) for r in regions]
    gram = _gradient_gram(V)
    element_force = integral([weight * _element_force(r.stress, gram) for r in responses])
    energies = [r.energy for r in responses if r.energy is not None]
    together = [residual, integral(elastic), element_force]
    if len(energies) == len(regions):
        together.append(integral(energies))
    forces, norm, scale, *energy = compat.compile_together(
        *together, compiler=unrolled(V.mesh.topology.cell_name())
    )
    return Forms(
        residual=forces,
        tangent=MatrixForm(fem.form(tangent, jit_options=in_any_order())),
        elastic_norm=norm,
        element_force=scale,
        energy=energy[0] if energy else None,
        direction=direction,
        force=create_vector(V),
        dilatation=dilatation,
        evaluations=points[0],
        found=points[1],
        committed=committed,
    )


def create_elastic(
    u: fem.Function, regions: Sequence[Region], kinematics: Kinematics, degree: int
) -> tuple[MatrixForm, fem.Constant]:
    """Return factor * int eps(v) : C : eps(w), the second derivative of `Forms.elastic_norm`.

    With the factor; collective.
    """
    V = u.function_space
    factor = fem.Constant(V.mesh, default_scalar_type(1.0))
    weight = factor * ufl.as_ufl(kinematics.weight(ufl.SpatialCoordinate(V.mesh)))
    strains = (_unturned(kinematics, u, f(V)) for f in (ufl.TestFunction, ufl.TrialFunction))
    of_v, of_w = strains
    terms = []
    for region, dx in zip(regions, measures(V, regions, degree), strict=True):
        stress = elastic_response(region.law, of_w, region.symbols)
        terms.append(weight * ufl.inner(stress, of_v) * dx)
    return MatrixForm(fem.form(reduce(add, terms))), factor


def create_change(
    u: fem.Function,
    regions: Sequence[Region],
    responses: Sequence[Response],
    kinematics: Kinematics,
    degree: int,
    eigenstrain: Eigenstrain | None,
) -> tuple[fem.Form, list[fem.Function]]:
    """Return int C : (eps(w) - e) : eps(v), C the tangent, and the Functions w and e; collective.

    For a strain that is linear in u.
    """
    V = u.function_space
    weight = ufl.as_ufl(kinematics.weight(ufl.SpatialCoordinate(V.mesh)))
    changes, v = [fem.Function(V)], ufl.TestFunction(V)
    strain, virtual = kinematics.virtual(u, changes[0]), kinematics.virtual(u, v)
    if eigenstrain is not None:
        changes.append(eigenstrain.function.copy())
        strain -= eigenstrain.tensor_of(changes[1])
    terms = []
    for response, dx in zip(responses, measures(V, regions, degree), strict=True):
        terms.append(weight * ufl.inner(response.change(strain), virtual) * dx)
    return fem.form(reduce(add, terms)), changes


def create_moduli(
    regions: Sequence[Region], kinematics: Kinematics, stress: fem.Function
) -> fem.Form:
    """Return int |C : (e_x e_y + e_y e_x)|, which is an energy, at one point of each cell."""
    domain = stress.function_space.mesh
    weight = ufl.as_ufl(kinematics.weight(ufl.SpatialCoordinate(domain)))
    shear = ufl.as_tensor([[0, 1, 0], [1, 0, 0], [0, 0, 0]])
    terms = []
    V = fem.functionspace(domain, ("DG", 0))
    for region, dx in zip(regions, measures(V, regions, 1), strict=True):
        modulus = elastic_response(region.law, shear, region.symbols)
        terms.append(weight * ufl.sqrt(ufl.inner(modulus, modulus)) * dx)
    return fem.form(reduce(add, terms))


def _unturned(kinematics: Kinematics, u: fem.Function, v: Expr) -> Expr:
    """Return the strain that v causes at u, of which turns of the deformed body have none."""
    along = kinematics.virtual(u, v)
    return ufl.sym(ufl.transpose(kinematics.measure(u)) * along) if kinematics.finite else along


def _from_energy(law: Law) -> bool:
    """Tell whether UFL makes the tangent of a law from its energy at F, and so a symmetric one."""
    derived = law.update is None and law.stress is None and law.tangent is None
    return derived and law.strain == "finite"


def moduli_first(response: Response, entries: Sequence[tuple[int, int]]) -> Response:
    """Return a response whose change is dP/dF, formed once at a point, times the direction.

    Of a symmetric dP/dF the upper triangle, row by row, for the entries of F that may change.
    Measured, tangents of Mooney-Rivlin's law: hexahedra .81 of the time, tetrahedra .66,
    quadrilaterals .88, triangles .86; of neo-Hooke's, which states its stress, .92 to .99.
    """

    def change(direction: Expr) -> Expr:
        columns = []
        for entry in entries:
            unit = [[1.0 if (i, j) == entry else 0.0 for j in range(3)] for i in range(3)]
            columns.append(response.change(ufl.as_tensor(unit)))
        rows: list[list[Expr]] = [[ufl.as_ufl(0.0)] * 3 for _ in range(3)]
        for a, (i, j) in enumerate(entries):
            parts = [columns[max(a, b)][entries[min(a, b)]] for b in range(len(entries))]
            terms = (part * direction[at] for part, at in zip(parts, entries, strict=True))
            rows[i][j] = reduce(add, terms)
        return ufl.as_tensor(rows)

    return dataclasses.replace(response, change=change)


def _tangent(
    u: fem.Function,
    responses: Sequence[Response],
    kinematics: Kinematics,
    integral: Callable[[Sequence[Expr]], ufl.Form],
) -> ufl.Form:
    """Return int d eps[v] : C : d eps[w] + sigma : d^2 eps[v, w], the consistent tangent.

    The second term, the geometric stiffness, vanishes where the strain is linear in u.
    """
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


def _gradient_gram(V: fem.FunctionSpace) -> Floats:
    """Return sum_a grad N_a (x) grad N_a at the midpoint of the reference cell, times its volume.

    Shape (d, d); the gradients are those of the reference cell.
    """
    element = V.element.basix_element
    d = V.mesh.topology.dim
    midpoint, weight = map(np.asarray, basix.make_quadrature(element.cell_type, 1))
    gradients = element.tabulate(1, midpoint)[1:, 0, :, 0].reshape(d, -1)
    return float(weight[0]) * gradients @ gradients.T


def _element_force(stress: Any, gram: Floats) -> Any:
    """Return the density of sum_a |f_ea|^2 over a cell, f_ea = sigma . grad N_a |cell|."""
    domain = ufl.domain.extract_unique_domain(stress)
    d = gram.shape[0]
    s = ufl.as_tensor([[stress[i, j] for j in range(d)] for i in range(d)])
    t = s * ufl.transpose(ufl.JacobianInverse(domain))
    return abs(ufl.JacobianDeterminant(domain)) * ufl.inner(t * ufl.as_matrix(gram.tolist()), t)
