# SPDX-License-Identifier: MIT
"""placeholder, replaced by the branch of the solid's room."""

from __future__ import annotations

from dolfinx import fem, la


class Loads:
    """Loads."""

    def __init__(self, V, u, loads, potential):
        self.form = None if loads is None else fem.form(loads)
        self.linear = True
        self.has_potential = False

    def assemble(self, f):
        f.set(0.0)
        if self.form is not None:
            assembled = fem.assemble_vector(self.form)
            assembled.scatter_reverse(la.InsertMode.add)
            f.array[:] = assembled.array[: f.local_size]

    def energy(self):
        return 0.0

    def add_forces(self, F):
        pass

    def add_tangent(self, K):
        pass
