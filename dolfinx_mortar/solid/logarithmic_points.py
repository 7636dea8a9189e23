# SPDX-License-Identifier: MIT
"""Small-strain laws at finite strain: energy, P and dP/dF at the integration points.

Stress and tangent are evaluated for each assembly, straight into what the forms read; internal
variables at the end of a step only.
"""

from dataclasses import replace

import numpy as np

import ufl
from dolfinx import fem, jit
from dolfinx_mortar.arrays import Floats, Ints
from dolfinx_mortar.kernels import ANYWHERE, Kernel, kernel_of
from dolfinx_mortar.materials.logarithmic import LogarithmicLaw, Start
from dolfinx_mortar.materials.ranges import ungrouped
from dolfinx_mortar.materials.tensor import stored
from dolfinx_mortar.solid.at_points import set_points
from dolfinx_mortar.solid.finite_points import FinitePointFields
from ufl.core.expr import Expr


class LogarithmicFields(FinitePointFields):
    """Energy, stress P, tangent and new state of a law of a small strain at F."""

    def _create_law(self, dimension: int) -> bool:
        """Compile the law once for all ranks, or take what is in the cache; collective."""
        comm = self.region.parameters.function.function_space.mesh.comm

        def compiled(vector: Expr) -> Kernel:
            found, module, _ = jit.ffcx_jit(comm, (vector, ANYWHERE))
            return kernel_of(found, module, vector)

        names = list(ungrouped(self.region.symbols))
        law = replace(self.region.law, plane_stress=False)  # H_zz is found here
        self._logarithmic = LogarithmicLaw(law, names, dimension=dimension, jit=compiled)
        self._start: tuple[list[Floats], Start] | None = None
        self._gradients = np.zeros((0, 3, 3))
        return self._logarithmic.has_energy

    def _wanted(self, F: Expr) -> Expr:
        """Return F - I, row by row: F is affine in u. Strains may be far below round-off of 1."""
        u = self._inputs[0]
        H = ufl.derivative(F, u, u)
        return ufl.as_vector([H[i, j] for i in range(3) for j in range(3)])

    def _evaluate(self) -> None:
        """Evaluate energy, stress and tangent.

        Raises:
            ValueError: if F has no positive determinant, or the law raises, returns something of
                another form, or gives NaN.
        """
        V, cells = self._stress.function_space, self.region.cells
        found = np.asarray(self._gradient.eval(V.mesh, cells))
        H = np.ascontiguousarray(found).reshape(-1, 3, 3)
        start = self._start_of_step()
        if self.normal is not None:
            self._logarithmic.find_normal(start, H)
        self._seen = []  # a law that fails leaves what it gave
        functions = [self._stress, self._tangent]
        functions += [] if self._energy is None else [self._energy]
        targets = [_table(f, cells) for f in functions]
        P, A, *psi = targets
        self._logarithmic.respond(start, H, P, A, psi[0][:, 0] if psi else np.empty(0))
        if not np.isfinite(P.sum() + A.sum()):
            F = H + np.eye(3)
            self._judge(
                np.asarray(np.linalg.det(F) <= 0.0), F, "is not called where det F is not positive:"
            )
            whole = np.isfinite(P).all(axis=1) & np.isfinite(A).all(axis=1)
            self._judge(np.logical_not(whole), F, "gives NaN or infinity")
        if self.normal is not None:
            self._logarithmic.condense(P, A)
            set_points(self.normal, cells, H[:, 2, 2:])
        for f, values in zip(functions, targets, strict=True):
            if values.base is None:
                set_points(f, cells, values)
        self._gradients = H

    def _copies(self, now: list[Floats]) -> list[Floats]:
        """Return copies of the inputs; the last ones are those of the start of the step."""
        assert self._start is not None
        kept = self._start[0]
        return [*(values.copy() for values in now[: len(now) - len(kept)]), *kept]

    def settle(self) -> None:
        """Evaluate the internal variables at the end of the step."""
        new = self._logarithmic.update(self._start_of_step(), self._gradients)
        for name, f in self._new.items():
            size, values = f.function_space.dofmap.bs, new[name]
            shown = stored(values, size) if values.ndim == 3 else values[:, None]
            set_points(f, self.region.cells, shown)

    def stress_lost(self) -> Floats:
        """Return by how much Kirchhoff's stress is below that of the law at points (q,).

        None of a law without memory: there it is no error that the stress turns from the strain.
        """
        if not self.region.law.state:
            return np.zeros(0)
        return self._logarithmic.stress_lost(self._start_of_step(), self._gradients)

    def _start_of_step(self) -> Start:
        """Return what the points know at the start of the step."""
        functions = [*self._committed.values(), self.region.parameters.function]
        now = [f.x.array for f in functions]
        if self._start is None or not all(map(np.array_equal, now, self._start[0])):
            cells = self.region.cells
            points = self._stress.function_space.dofmap.list.shape[1]
            p = ungrouped(self.region.parameters.values(cells, points))
            start = self._logarithmic.start(len(cells) * points, self._state_at(cells), p)
            self._start = [values.copy() for values in now], start
        return self._start[1]


def _table(f: fem.Function, cells: Ints) -> Floats:
    """Return the values (q, components) of a Function at points, a view where they are in order."""
    dofmap = f.function_space.dofmap
    rows, table = dofmap.list[cells].ravel(), f.x.array.reshape(-1, dofmap.bs)
    if len(rows) and np.array_equal(rows, np.arange(rows[0], rows[0] + len(rows))):
        return np.asarray(table[rows[0] : rows[0] + len(rows)])
    return np.empty((len(rows), dofmap.bs))
