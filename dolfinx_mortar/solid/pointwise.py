# SPDX-License-Identifier: MIT
"""Local equations at the integration points, solved before each assembly; forms read the results.

Laws of arrays give stress, consistent tangent and new internal variables; local condensation for
plane stress gives the strain out of the plane.
"""

from collections.abc import Mapping, Sequence

from mpi4py import MPI

import numba
import numpy as np

import ufl
from dolfinx import fem
from dolfinx_mortar import compat
from dolfinx_mortar.algebra.errors import raised_together
from dolfinx_mortar.algebra.parallel import maximum
from dolfinx_mortar.arrays import Floats, Ints
from dolfinx_mortar.materials.plane_stress import solve
from dolfinx_mortar.materials.protocol import Law
from dolfinx_mortar.materials.response import PointValues, Response, respond, values_at_points
from dolfinx_mortar.materials.tensor import (
    INDEX,
    from_components,
    stored,
    tensor_of,
    to_components,
)
from dolfinx_mortar.solid.at_points import (
    PointValuesOfRegion,
    middle_of,
    pairs,
    set_points,
    symmetric_rows,
)
from dolfinx_mortar.solid.finite_points import FinitePointFields
from dolfinx_mortar.solid.laws import Region
from dolfinx_mortar.solid.logarithmic_points import LogarithmicFields
from dolfinx_mortar.solid.sources import point_function
from dolfinx_mortar.solid.state import as_tensors, create_field
from ufl.core.expr import Expr


class NormalStrain(PointValuesOfRegion):
    """The strain out of the plane that leaves no stress there, for a law in UFL.

    At finite strain the stretch less 1.

    Attributes:
        normal: it, zero in other regions.
    """

    def _create(self, strain: Expr, degree: int) -> None:
        """Create the Function and compile its equation; collective."""
        region, domain = self.region, self.region.parameters.function.function_space.mesh
        self.normal = create_field(domain, degree, (), "strain_out_of_the_plane")
        committed = as_tensors(region, self._committed)
        with raised_together(domain.comm):
            self.response = respond(region.law, strain, committed, region.symbols, self.normal)
        found = self.response.normal_strain
        if found is None:
            assert self.response.equation is not None
            found = ufl.as_vector(self.response.equation)
        points = compat.interpolation_points(self.normal.function_space)
        self._equation = fem.Expression(found, points)
        start = self.response.start
        self._start = None if start is None else fem.Expression(start, points)

    def _evaluate(self) -> None:
        """Solve the equation at all points, or take its root from the law."""
        V, cells, values = self.normal.function_space, self.region.cells, self.normal.x.array
        dofs = V.dofmap.list[cells]
        if self.response.normal_strain is not None:
            values[dofs] = np.asarray(self._equation.eval(V.mesh, cells)).reshape(dofs.shape)
            return

        def equation(rows: Ints, z: Floats) -> Floats:
            values[dofs[rows]] = z
            found = np.asarray(self._equation.eval(V.mesh, cells[rows]))
            return found.reshape(*z.shape, 4)

        before, law = values.copy(), self.region.law
        finite, start = law.strain == "finite", None
        if self._start is not None:
            start = np.asarray(self._start.eval(V.mesh, cells)).reshape(dofs.shape)
        try:
            values[dofs] = solve(law.name, equation, dofs.shape, finite=finite, start=start)
        except ValueError:
            values[:] = before
            raise


class PointwiseFields(PointValuesOfRegion):
    """Stress, tangent and new state of a law of arrays."""

    def _create(self, strain: Expr, degree: int) -> None:
        """Create the Functions; collective."""
        domain = self.region.parameters.function.function_space.mesh
        self._stress = create_field(domain, degree, (3, 3), "stress")
        size = self._stress.function_space.dofmap.bs
        self._tangent = point_function(domain, degree, (len(pairs(size)),))
        points = compat.interpolation_points(self._stress.function_space)
        self._strain = fem.Expression(to_components(strain, size), points)
        self._new = {name: f.copy() for name, f in self._committed.items()}
        new = as_tensors(self.region, self._new)
        self.response = Response(from_components(self._stress), None, new, self._change)

    def _evaluate(self) -> None:
        """Call the law.

        Raises:
            ValueError: if it raises, returns something of another form, or gives NaN.
        """
        cells = self.region.cells
        V, size = self._stress.function_space, self._stress.function_space.dofmap.bs
        strain = tensor_of(np.asarray(self._strain.eval(V.mesh, cells)).reshape(-1, size))
        state = self._state_at(cells)
        points = V.dofmap.list.shape[1]
        p = self.region.parameters.values(cells, points)
        found = values_at_points(self.region.law, strain, state, p)
        self._judge(found, strain, points)
        set_points(self._stress, cells, stored(found.stress, size))
        set_points(self._tangent, cells, packed(found.tangent, size))
        for name, f in self._new.items():
            new = found.state[name]
            set_points(f, cells, stored(new, size) if new.ndim == 3 else new[:, None])

    def _change(self, direction: Expr) -> Expr:
        """Return the tangent times a direction, 3x3."""
        size = self._stress.function_space.dofmap.bs
        e, rows = to_components(direction, size), symmetric_rows(self._tangent, size)
        # a stored shear stands for two components
        sums = [
            sum(rows[i][j] * (1 if j < 3 else 2) * e[j] for j in range(size)) for i in range(size)
        ]
        return from_components(ufl.as_vector(sums))

    def _judge(self, found: PointValues, strain: Floats, points: int) -> None:
        """Raise ValueError if something is NaN, naming the first point."""
        undefined = np.flatnonzero(found.undefined)
        if undefined.size:
            cell, point = divmod(int(undefined[0]), points)
            middle = middle_of(self._stress.function_space.mesh, self.region.cells[cell])
            values = ", ".join(f"{v:.6g}" for v in stored(strain[undefined[:1]])[0])
            raise ValueError(
                f"{self.region.law.name}.update gives NaN or infinity at {undefined.size} "
                f"integration points, first at point {point} of the cell around {middle}, where "
                f"the strain (xx, yy, zz, xy, yz, xz) is ({values})."
            )


def create_point_values(
    regions: Sequence[Region],
    strain: Expr,
    state: Mapping[str, fem.Function],
    inputs: Sequence[fem.Function],
    degree: int,
    *,
    finite: bool = False,
) -> dict[Law, PointValuesOfRegion]:
    """Return what is found at points before each assembly, by law; collective.

    The strain is F where strains are finite; of laws in UFL only those of F read it themselves.
    """
    found: dict[Law, PointValuesOfRegion] = {}
    for region in regions:
        arguments = region, strain, state, inputs, degree
        if finite and region.law.strain == "small":
            found[region.law] = LogarithmicFields(*arguments)
        elif finite and region.law.update is not None:
            found[region.law] = FinitePointFields(*arguments)
        elif region.law.update is not None:
            found[region.law] = PointwiseFields(*arguments)
        elif region.law.condensed:
            found[region.law] = NormalStrain(*arguments)
    return found


def fill_point_values(
    comm: MPI.Comm, found: Mapping[Law, PointValuesOfRegion], *, at_end: bool = False
) -> None:
    """Evaluate at points where something has changed; collective if there is anything.

    At the end of a step what only that needs.

    Raises:
        ValueError: on all ranks, if a law fails on any.
    """
    if found:
        with raised_together(comm):
            for values in found.values():
                values.settle() if at_end else values.fill()


def normal_strain(found: Mapping[Law, PointValuesOfRegion]) -> Expr:
    """Return the strain out of the plane that has been found at the points, 0 without any."""
    of_laws = NormalStrain, FinitePointFields
    parts = [v.normal for v in found.values() if isinstance(v, of_laws) and v.normal is not None]
    return sum(parts[1:], parts[0]) if parts else ufl.as_ufl(0.0)


def largest_stress_lost(
    comm: MPI.Comm, found: Mapping[Law, PointValuesOfRegion]
) -> tuple[float, str]:
    """Return the largest share of `LogarithmicFields.stress_lost`, and which law's; collective."""
    parts = [values for values in found.values() if isinstance(values, LogarithmicFields)]
    local = [float(values.stress_lost().max(initial=0.0)) for values in parts]
    if not parts:
        return 0.0, ""
    shares = maximum(comm, *local)
    worst = int(np.argmax(shares))
    return float(shares[worst]), parts[worst].region.law.name


def packed(tangent: Floats, size: int) -> Floats:
    """Return the upper triangle of the stored part of tangents (q, 3, 3, 3, 3), row by row.

    Entry (I, J) is the mean of both that the symmetry of an energy makes equal.
    """
    terms = np.empty((len(pairs(size)), 2), dtype=np.int64)
    for t, (a, b) in enumerate(pairs(size)):
        ways = [(*INDEX[a], *INDEX[b]), (*INDEX[b], *INDEX[a])]
        terms[t] = [np.ravel_multi_index(way, (3, 3, 3, 3)) for way in ways]
    return np.asarray(_means(np.ascontiguousarray(tangent).reshape(len(tangent), 81), terms))


@numba.njit(cache=True)
def _means(values, terms):  # type: ignore[no-untyped-def]
    """Return the means (q, t) of the columns terms (t, 2) of values (q, n).

    By array expressions they would take as long as all the rest of an assembly.
    """
    means = np.empty((len(values), len(terms)))
    for q in range(len(values)):
        for t in range(len(terms)):
            a, b = terms[t]
            means[q, t] = (values[q, a] + values[q, b]) / 2
    return means
