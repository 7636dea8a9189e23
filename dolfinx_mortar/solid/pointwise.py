# SPDX-License-Identifier: MIT
"""Laws evaluated at the integration points before each assembly; forms read the results."""

from collections.abc import Mapping, Sequence

from mpi4py import MPI

import numpy as np

import ufl
from dolfinx import fem, jit
from dolfinx_mortar.algebra.parallel import maximum, raised_together
from dolfinx_mortar.common.arrays import Bools, Floats, Ints
from dolfinx_mortar.common.kernels import ANYWHERE, Kernel, kernel_of
from dolfinx_mortar.materials.logarithmic import CompiledLaw, LogarithmicLaw
from dolfinx_mortar.materials.protocol import Law
from dolfinx_mortar.materials.response import Response
from dolfinx_mortar.materials.tensor import (
    contract,
    from_entries,
    stored,
    tensor_of,
    upper_triangle,
)
from dolfinx_mortar.solid.laws import Region
from dolfinx_mortar.solid.sources import Part, create_source, middle_of, point_function
from ufl.core.expr import Expr


class PointValuesOfRegion:
    """Stress, upper triangle of the tangent, state and energy at the points of a region.

    Attributes:
        response: of the law, in terms of these values.
        normal: z in plane stress, else None.
        at_points: the law.
    """

    def __init__(
        self,
        region: Region,
        strain: Expr,
        state: Mapping[str, fem.Function],
        inputs: Sequence[fem.Function],
        degree: int,
        *,
        finite: bool,
    ) -> None:
        """Create the Functions, which depend on the inputs; collective.

        The strain is F - I if `finite`: it may be far below round-off of 1.
        """
        self.region, self._mesh, self._finite = region, region.mesh, finite
        self._committed = {name: state[name] for name in region.law.state}
        self._inputs = [region.function, *self._committed.values(), *inputs]
        self._seen: list[Floats] = []
        law, domain = region.law, region.mesh
        with raised_together(domain.comm):
            self.at_points = self._create_law()
        entries, size = self.at_points.components, len(self.at_points.components)
        self._stress = point_function(domain, degree, (size,))
        self._points = self._stress.function_space.dofmap.list.shape[1]
        self._tangent = point_function(domain, degree, (len(upper_triangle(size)),))
        self._energy = point_function(domain, degree) if self.at_points.has_energy else None
        self.normal = point_function(domain, degree) if law.plane_stress else None
        nine = ufl.as_vector([strain[i, j] for i in range(3) for j in range(3)])
        part = Part(f"{law.name}: the strain", self._stress, nine)
        self._strain = create_source(region.cells, part)
        self._new = {name: f.copy() for name, f in self._committed.items()}
        stress = from_entries(entries, self._stress, not finite)
        self.response = Response(stress, self._energy, region.tensors(self._new), self._change)

    def _create_law(self) -> CompiledLaw:
        """Compile the law once for all ranks, or load it; collective."""

        def compiled(vector: Expr) -> Kernel:
            found, module, _ = jit.ffcx_jit(self._mesh.comm, (vector, ANYWHERE))
            return kernel_of(found, module, vector)

        law, d = self.region.law, self._mesh.geometry.dim
        kind = LogarithmicLaw if self._finite and law.strain == "small" else CompiledLaw
        return kind(law, self.region.names, dimension=d, jit=compiled)

    def _change(self, direction: Expr) -> Expr:
        entries = self.at_points.components
        number = {pair: k for k, pair in enumerate(upper_triangle(len(entries)))}

        def moduli(a: int, b: int) -> Expr:
            return self._tangent[number[a, b]]

        return contract(entries, moduli, direction, symmetric=not self._finite)

    def fill(self) -> None:
        """Evaluate the law if an input has changed, or raise a ValueError; not collective."""
        now = [f.x.array for f in self._inputs]
        same = [*map(np.array_equal, now, self._seen)] or [False]
        if not all(same):
            self._seen = []  # invalid until the law succeeds
            if not all(same[: 1 + len(self._committed)]):
                p = self.region.parameters(self.region.cells, self._points)
                q = self.region.cells.size * self._points
                self._start = self.at_points.start(q, self._state(), p)
            self._evaluate()
            self._seen = [values.copy() for values in now]

    def _evaluate(self) -> None:
        """Fill the Functions; an error leaves them unchanged."""
        strain = np.ascontiguousarray(self._strain.evaluate()[0]).reshape(-1, 3, 3)
        if self._finite and self.region.law.update is not None:
            self._judge(self._inverted(strain), strain, INSIDE_OUT)
        stress, tangent, psi = self.at_points.evaluate(self._start, strain)
        if not np.isfinite(stress.sum() + tangent.sum()):  # faster than a test of each
            undefined = ~np.isfinite(stress.sum(axis=1) + tangent.sum(axis=1))
            self._judge(self._inverted(strain), strain, INSIDE_OUT)
            self._judge(undefined, strain, UNDEFINED)
        parts = [(self._stress, stress), (self._tangent, tangent), (self._energy, psi)]
        for f, values in [*parts, (self.normal, strain[:, 2, 2])]:
            if f is not None:
                self._set(f, values)
        self._measured = strain

    def settle(self) -> None:
        """Evaluate the internal variables at the end of the step; not collective."""
        new = self.at_points.update(self._start, self._measured, self._state())
        for name, f in self._new.items():
            self._set(f, new[name])

    def stress_lost(self) -> Floats:
        """Error of the stress (q,), see `LogarithmicLaw`."""
        assert isinstance(self.at_points, LogarithmicLaw)
        return self.at_points.stress_lost(self._start, self._measured)

    def _state(self) -> dict[str, Floats]:
        """Committed internal variables at the points, (q,) or (q, 3, 3)."""
        found = {}
        for name, f in self._committed.items():
            values = f.x.array.reshape(-1, f.function_space.dofmap.bs)[self._rows(f)]
            found[name] = tensor_of(values) if values.shape[1] > 1 else values[:, 0]
        return found

    def _rows(self, f: fem.Function) -> Ints | slice:
        """Points of a Function, a slice (faster) if they are in order."""
        rows = np.asarray(f.function_space.dofmap.list[self.region.cells].ravel())
        in_order = rows.size and rows[-1] - rows[0] == rows.size - 1 and (np.diff(rows) == 1).all()
        return slice(rows[0], rows[-1] + 1) if in_order else rows

    def _set(self, f: fem.Function, values: Floats) -> None:
        """Set a Function at the points from values or tensors (q, 3, 3)."""
        size = f.function_space.dofmap.bs
        values = stored(values, size) if values.ndim == 3 else values.reshape(-1, size)
        f.x.array.reshape(-1, size)[self._rows(f)] = values

    def _inverted(self, strain: Floats) -> Bools:
        if not self._finite:
            return np.zeros(len(strain), dtype=bool)
        return np.asarray(np.linalg.det(strain + np.eye(3)) <= 0.0)

    def _judge(self, bad: Bools, strain: Floats, what: str) -> None:
        wrong = np.flatnonzero(bad)
        if wrong.size:
            cell, point = divmod(int(wrong[0]), self._points)
            method = ".update" if self.region.law.update else ""
            values = strain[wrong[0]] + np.eye(3) * self._finite
            raise ValueError(
                f"{self.region.law.name}{method} {what} at {wrong.size} integration points, first "
                f"at point {point} of the cell around "
                f"{middle_of(self._mesh, self.region.cells[cell])}, where "
                f"{'F' if self._finite else 'the strain'} (row by row) is "
                f"({', '.join(f'{v:.6g}' for v in values.ravel())})."
            )


INSIDE_OUT, UNDEFINED = "is not called where det F is not positive:", "gives NaN or infinity"


def create_point_values(
    regions: Sequence[Region],
    strain: Expr,
    state: Mapping[str, fem.Function],
    inputs: Sequence[fem.Function],
    degree: int,
    *,
    finite: bool = False,
) -> dict[Law, PointValuesOfRegion]:
    """Values computed at points before each assembly; of F - I if `finite`; collective."""
    given = strain, state, inputs, degree
    return {
        region.law: PointValuesOfRegion(region, *given, finite=finite)
        for region in regions
        if region.law.at_points or (finite and region.law.strain == "small")
    }


def fill_point_values(
    comm: MPI.Comm, found: Mapping[Law, PointValuesOfRegion], *, at_end: bool = False
) -> None:
    """Evaluate changed ones, `at_end` completely; a ValueError on all ranks; collective."""
    if found:
        with raised_together(comm):
            for values in found.values():
                values.settle() if at_end else values.fill()


def normal_strain(found: Mapping[Law, PointValuesOfRegion]) -> Expr:
    """Strain out of the plane at the points, 0 without any."""
    parts = [values.normal for values in found.values() if values.normal is not None]
    return sum(parts[1:], parts[0]) if parts else ufl.as_ufl(0.0)


def largest_stress_lost(
    comm: MPI.Comm, found: Mapping[Law, PointValuesOfRegion]
) -> tuple[float, str]:
    """Largest `LogarithmicFields.stress_lost` of laws with memory, and its law; collective."""
    kinds = [values for law, values in found.items() if law.state and not law.isotropic]
    parts = [values for values in kinds if isinstance(values.at_points, LogarithmicLaw)]
    if not parts:
        return 0.0, ""
    fill_point_values(comm, found)
    local = [float(values.stress_lost().max(initial=0.0)) for values in parts]
    shares = maximum(comm, *local)
    worst = int(np.argmax(shares))
    return float(shares[worst]), parts[worst].region.law.name
