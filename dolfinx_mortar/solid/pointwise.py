# SPDX-License-Identifier: MIT
"""Laws evaluated at the integration points before each assembly; forms read the results."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import replace

from mpi4py import MPI

import numba
import numpy as np

import ufl
from dolfinx import fem, jit
from dolfinx_mortar.algebra.parallel import maximum, raised_together
from dolfinx_mortar.common.arrays import Bools, Floats, Ints
from dolfinx_mortar.common.kernels import ANYWHERE, Kernel, kernel_of
from dolfinx_mortar.materials.logarithmic import LogarithmicLaw
from dolfinx_mortar.materials.protocol import Law
from dolfinx_mortar.materials.response import (
    Response,
    respond,
    solve_normal_strain,
    values_at_points,
)
from dolfinx_mortar.materials.tensor import (
    COMPONENTS,
    GRADIENT,
    INDEX,
    contract,
    stored,
    tensor_of,
    upper_triangle,
)
from dolfinx_mortar.solid.laws import Region
from dolfinx_mortar.solid.sources import Part, create_source, middle_of, point_function, unchanged
from ufl.core.expr import Expr


class PointValuesOfRegion(ABC):
    """Values at the points of a region, computed before assembly.

    Attributes:
        response: of the law, in terms of these values.
        normal: z in plane stress, else zero.
    """

    response: Response
    normal: fem.Function | None = None

    def __init__(
        self,
        region: Region,
        strain: Expr,
        state: Mapping[str, fem.Function],
        inputs: Sequence[fem.Function],
        degree: int,
    ) -> None:
        """Create the Functions, which depend on the inputs; collective."""
        self.region = region
        self._mesh = region.mesh
        self._committed = {name: state[name] for name in region.law.state}
        self._inputs = [region.function, *self._committed.values(), *inputs]
        self._seen: list[Floats] = []
        self._create(strain, degree)

    @abstractmethod
    def _create(self, strain: Expr, degree: int) -> None:
        """Create the Functions and the response, compile; collective."""

    @abstractmethod
    def _evaluate(self) -> None:
        """Fill the Functions; an error leaves them unchanged."""

    def fill(self) -> None:
        """Evaluate the law if an input has changed, or raise a ValueError; not collective."""
        now = [f.x.array for f in self._inputs]
        same = [*map(np.array_equal, now, self._seen)] or [False]
        if not all(same):
            self._seen = []  # invalid until the law succeeds
            if not all(same[: 1 + len(self._committed)]):
                self._begin()
            self._evaluate()
            self._seen = [values.copy() for values in now]

    def _begin(self) -> None:  # noqa: B027
        """Prepare evaluations with the present parameters and committed state."""

    def settle(self) -> None:  # noqa: B027 - most have evaluated everything by then
        """Evaluate the values needed at the end of a step only; not collective."""

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


class NormalStrain(PointValuesOfRegion):
    """The strain (stretch less 1) z in plane stress, of a law in UFL."""

    def _create(self, strain: Expr, degree: int) -> None:
        region = self.region
        self.normal = point_function(self._mesh, degree, (), "strain_out_of_the_plane")
        committed = region.tensors(self._committed)
        with raised_together(self._mesh.comm):
            self.response = respond(region.law, strain, committed, region.symbols, self.normal)
        found, start = self.response.normal_strain, self.response.start
        if found is None:
            assert self.response.equation is not None
            found = ufl.as_vector(self.response.equation)
        name = f"{region.law.name}: the strain out of the plane"
        self._equation = create_source(region.cells, Part(name, self.normal, found))
        part = None if start is None else Part(name, self.normal, start)
        self._start = None if part is None else create_source(region.cells, part)

    def _evaluate(self) -> None:
        assert self.normal is not None
        if self.response.normal_strain is not None:
            self._equation.fill()
            return
        cells, values, law = self.region.cells, self.normal.x.array, self.region.law
        dofs = self.normal.function_space.dofmap.list[cells]

        def equation(rows: Ints, z: Floats) -> Floats:
            values[dofs[rows]] = z
            return self._equation.evaluate(cells[rows])[0]

        start = None if self._start is None else self._start.evaluate()[0][..., 0]
        with unchanged([self.normal], on_error=True):
            values[dofs] = solve_normal_strain(
                law.name, equation, dofs.shape, finite=law.strain == "finite", start=start
            )


class PointwiseFields(PointValuesOfRegion):
    """Stress, upper triangle of the tangent, state and energy of a law of arrays."""

    def _create(self, strain: Expr, degree: int) -> None:
        law, domain = self.region.law, self._mesh
        with raised_together(domain.comm):
            self._finite, has_energy = self._create_law()
        d = domain.geometry.dim
        self._entries = GRADIENT[d] if self._finite else INDEX[: len(COMPONENTS[d])]
        size = len(self._entries)
        self._stress = point_function(domain, degree, (size,))
        self._points = self._stress.function_space.dofmap.list.shape[1]
        self._tangent = point_function(domain, degree, (len(upper_triangle(size)),))
        self._energy = point_function(domain, degree) if has_energy else None
        self.normal = point_function(domain, degree) if law.plane_stress else None
        wanted = self._wanted(strain)
        nine = ufl.as_vector([wanted[i, j] for i in range(3) for j in range(3)])
        part = Part(f"{law.name}: the strain", self._stress, nine)
        self._strain = create_source(self.region.cells, part)
        self._new = {name: f.copy() for name, f in self._committed.items()}
        new, rows = self.region.tensors(self._new), [[ufl.as_ufl(0.0)] * 3 for _ in range(3)]
        for (i, j), entry in zip(self._entries, self._stress, strict=True):
            rows[i][j] = entry
            rows[j][i] = rows[j][i] if self._finite else entry
        self.response = Response(ufl.as_tensor(rows), self._energy, new, self._change)

    def _create_law(self) -> tuple[bool, bool]:
        """Whether the law is one of F, and whether it has a potential."""
        finite = self.region.law.strain == "finite"
        return finite, finite and self.region.law.energy is not None

    def _wanted(self, strain: Expr) -> Expr:
        """Tensor evaluated at the points before the law."""
        return strain

    def _change(self, direction: Expr) -> Expr:
        number = {pair: k for k, pair in enumerate(upper_triangle(len(self._entries)))}

        def moduli(a: int, b: int) -> Expr:
            return self._tangent[number[a, b]]

        return contract(self._entries, moduli, direction, symmetric=not self._finite)

    def _measured(self) -> Floats:
        return np.ascontiguousarray(self._strain.evaluate()[0]).reshape(-1, 3, 3)

    def _evaluate(self) -> None:
        region, strain = self.region, self._measured()
        if self._finite:
            self._judge(np.linalg.det(strain) <= 0.0, strain, INSIDE_OUT)
        p = region.parameters(region.cells, self._points)
        answer = values_at_points(region.law, strain, self._state(), p)
        self._judge(answer.undefined, strain, UNDEFINED)
        rows, columns = np.array(self._entries).T
        stress = answer.stress
        self._set(self._stress, stress[:, rows, columns] if self._finite else stress)
        self._set(self._tangent, packed(answer.tangent, self._entries))
        parts = [(self._energy, answer.energy), (self.normal, answer.normal)]
        parts += [(f, answer.state[name]) for name, f in self._new.items()]
        for f, values in parts:
            if f is not None and values is not None:
                self._set(f, values)

    def _judge(self, bad: Bools, strain: Floats, what: str) -> None:
        wrong = np.flatnonzero(bad)
        if wrong.size:
            cell, point = divmod(int(wrong[0]), self._points)
            method = ".update" if self.region.law.update else ""
            raise ValueError(
                f"{self.region.law.name}{method} {what} at {wrong.size} integration points, first "
                f"at point {point} of the cell around "
                f"{middle_of(self._mesh, self.region.cells[cell])}, where "
                f"{'F' if self._finite else 'the strain'} (row by row) is "
                f"({', '.join(f'{v:.6g}' for v in strain[wrong[0]].ravel())})."
            )


INSIDE_OUT, UNDEFINED = "is not called where det F is not positive:", "gives NaN or infinity"


class LogarithmicFields(PointwiseFields):
    """Energy, P, tangent and, at the end, new state of a small-strain law at F."""

    def _create_law(self) -> tuple[bool, bool]:
        """Compile the law once for all ranks, or load it; collective."""

        def compiled(vector: Expr) -> Kernel:
            found, module, _ = jit.ffcx_jit(self._mesh.comm, (vector, ANYWHERE))
            return kernel_of(found, module, vector)

        names, d = self.region.names, self._mesh.geometry.dim
        law = replace(self.region.law, plane_stress=False)  # H_zz is an unknown here
        self._law = LogarithmicLaw(law, names, dimension=d, jit=compiled)
        return True, self._law.has_energy

    def _wanted(self, strain: Expr) -> Expr:
        """F - I: strains may be far below round-off of 1."""
        u = self._inputs[1 + len(self._committed)]
        return ufl.derivative(strain, u, u)

    def _evaluate(self) -> None:
        H = self._measured()
        if self.normal is not None:
            self._law.find_normal(self._start, H)
        P, A, psi = self._law.response(self._start, H)
        if not np.isfinite(P.sum() + A.sum()):  # faster than a test of each
            F, undefined = H + np.eye(3), ~np.isfinite(P.sum(axis=1) + A.sum(axis=1))
            self._judge(np.linalg.det(F) <= 0.0, F, INSIDE_OUT)
            self._judge(undefined, F, UNDEFINED)
        if self.normal is not None:
            self._law.condense(P, A)
            self._set(self.normal, H[:, 2, 2])
        self._set(self._stress, P)
        self._set(self._tangent, A)
        if self._energy is not None:
            self._set(self._energy, psi)
        self._gradients = H

    def settle(self) -> None:
        """Evaluate the internal variables at the end of the step."""
        new = self._law.update(self._start, self._gradients, self._state())
        for name, f in self._new.items():
            self._set(f, new[name])

    def stress_lost(self) -> Floats:
        """Error of the stress (q,), see `LogarithmicLaw`."""
        return self._law.stress_lost(self._start, self._gradients)

    def _begin(self) -> None:
        p = self.region.parameters(self.region.cells, self._points)
        q = self.region.cells.size * self._points
        self._start = self._law.start(q, self._state(), p)


def create_point_values(
    regions: Sequence[Region],
    strain: Expr,
    state: Mapping[str, fem.Function],
    inputs: Sequence[fem.Function],
    degree: int,
    *,
    finite: bool = False,
) -> dict[Law, PointValuesOfRegion]:
    """Values computed at points before each assembly; of F if `finite`; collective."""
    found: dict[Law, PointValuesOfRegion] = {}
    for region in regions:
        kind: type[PointValuesOfRegion]
        if finite and region.law.strain == "small":
            kind = LogarithmicFields
        elif region.law.update is not None:
            kind = PointwiseFields
        elif region.law.condensed:
            kind = NormalStrain
        else:
            continue
        found[region.law] = kind(region, strain, state, inputs, degree)
    return found


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
    parts = [values for values in kinds if isinstance(values, LogarithmicFields)]
    if not parts:
        return 0.0, ""
    fill_point_values(comm, found)
    local = [float(values.stress_lost().max(initial=0.0)) for values in parts]
    shares = maximum(comm, *local)
    worst = int(np.argmax(shares))
    return float(shares[worst]), parts[worst].region.law.name


def packed(tangent: Floats, entries: Sequence[tuple[int, int]]) -> Floats:
    """Upper triangle of tangents (q, 3, 3, 3, 3), symmetrised, row by row."""
    a, b = np.array(upper_triangle(len(entries))).T
    at = np.array(entries) @ [3, 1]
    terms = np.stack([9 * at[a] + at[b], 9 * at[b] + at[a]], axis=1)
    return np.asarray(_means(np.ascontiguousarray(tangent).reshape(len(tangent), 81), terms))


@numba.njit(cache=True)
def _means(values, terms):  # type: ignore[no-untyped-def]
    """Means (q, t) of columns terms (t, 2) of values (q, n)."""
    means = np.empty((len(values), len(terms)))
    for q in range(len(values)):
        for t in range(len(terms)):
            a, b = terms[t]
            means[q, t] = (values[q, a] + values[q, b]) / 2
    return means
