# SPDX-License-Identifier: MIT
"""Dirichlet conditions as marks and values of dofs; those of an axis of rotation."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from dolfinx import fem, la
from dolfinx_mortar.algebra.parallel import maximum, raised_together
from dolfinx_mortar.common.arrays import Bools, Floats, Ints
from dolfinx_mortar.geometry.tolerances import ROUND_OFF
from dolfinx_mortar.solid.kinematics import on_axis
from dolfinx_mortar.solid.solid import Solid


def prescribed_dofs(V: fem.FunctionSpace, bcs: Sequence[fem.DirichletBC]) -> Bools:
    """Mask (local nodes, d) of prescribed components; a ValueError on all ranks; collective."""
    with raised_together(V.mesh.comm):
        for bc in bcs:
            _check_dofs(V, bc)
    return marked_dofs(V, [bc.dof_indices()[0] for bc in bcs])


def marked_dofs(V: fem.FunctionSpace, dofs: Iterable[Ints]) -> Bools:
    """Mask (local nodes, d) of components located on any rank; collective."""
    d = V.dofmap.index_map_bs
    marks = la.vector(V.dofmap.index_map, d)
    marks.array[:] = 0.0
    for some in dofs:
        marks.array[some] = 1.0
    marks.scatter_reverse(la.InsertMode.add)
    marks.scatter_forward()
    return np.asarray(marks.array > 0.0).reshape(-1, d)


def _check_dofs(V: fem.FunctionSpace, bc: fem.DirichletBC) -> None:
    dofs, layout, d = bc.dof_indices()[0], V.dofmap.index_map, V.dofmap.index_map_bs
    count = layout.size_local + layout.num_ghosts
    outside = dofs[(dofs < 0) | (dofs >= d * count)]
    if len(outside):
        raise ValueError(
            f"bcs holds a condition on the dof {outside[0] // d}: this rank has 0 to {count - 1}; "
            "take dofs from dolfinx.fem.locate_dofs_topological or locate_dofs_geometrical"
        )
    component = bc.function_space.component()
    if component and (dofs % d != component[0]).any():
        raise ValueError(
            f"bcs holds a condition on V.sub({component[0]}) at dofs of other components: locate "
            f"its dofs on V.sub({component[0]}), not on V"
        )


@dataclass(frozen=True)
class Dirichlet:
    """Dirichlet conditions of a problem; values are read in every step."""

    V: fem.FunctionSpace
    bcs: list[fem.DirichletBC]
    fixed: Bools  # (local nodes, d) prescribed components

    @property
    def owned(self) -> Bools:
        """Mask (n, d) of prescribed components of owned nodes."""
        return np.asarray(self.fixed[: self.V.dofmap.index_map.size_local])

    def values(self) -> Floats:
        """Prescribed values at owned dofs, 0 where free; a ValueError on all ranks; collective."""
        V, layout, known = self.V, self.V.dofmap.index_map, self.owned.ravel()
        d, n, comm = V.dofmap.index_map_bs, known.size, V.mesh.comm
        given = np.zeros(self.fixed.size)
        largest = np.full((2, len(given)), -np.inf)  # of values, and of their negatives
        for bc in self.bcs:
            bc.set(given)
            dofs = bc.dof_indices()[0]
            largest[:, dofs] = np.maximum(largest[:, dofs], [given[dofs], -given[dofs]])
        ghosts = layout.ghosts.astype(PETSc.IntType)
        shared = PETSc.Vec().createGhost(ghosts, (n, None), bsize=d, comm=comm)
        for values in largest:
            with shared.localForm() as local:
                local.array_w[:] = values
            shared.ghostUpdate(PETSc.InsertMode.MAX_VALUES, PETSc.ScatterMode.REVERSE)
            values[:n] = shared.array_r
        shared.destroy()
        high, low, X = largest[0, :n], -largest[1, :n], V.tabulate_dof_coordinates()
        allowed = ROUND_OFF * maximum(comm, *(np.abs(v).max(initial=0.0) for v in (X, given))).sum()
        told = ""
        with np.errstate(invalid="ignore"):
            differ = np.flatnonzero(known & (high - low > allowed))
        for i in differ[:1]:
            x = np.where(np.abs(X[i // d]) > allowed, X[i // d], 0.0)[: V.mesh.geometry.dim]
            place = ", ".join(f"{v:.4g}" for v in x)
            told = f"{low[i]:.10g} and {high[i]:.10g} for V.sub({i % d}) at ({place})"
        every = [text for text in comm.allgather(told) if text]
        if every:
            raise ValueError(
                "bcs: conditions prescribe different displacements of one node, such as "
                f"{every[0]}: leave each node and component to one of them, or give them equal "
                "values there"
            )
        return np.where(known, high, 0.0)

    def warnings(self) -> list[str]:
        """Warning for each condition without dofs; collective."""
        found = [len(bc.dof_indices()[0]) for bc in self.bcs]
        counts = self.V.mesh.comm.allreduce(np.array(found, dtype=np.int64))
        told = []
        for k in np.flatnonzero(counts == 0):
            component = self.bcs[k].function_space.component()
            where = f"V.sub({component[0]})" if component else "V"
            told.append(
                f"bcs[{k}], on {where}, has no dofs, so that it holds nothing: check the tag or "
                "the function that locates them, or leave it out"
            )
        return told

    def increment(self, target: Floats, u: Floats) -> Floats:
        """Prescribed minus present values, (owned nodes, d), 0 where free."""
        difference = (target - u[: target.size]).reshape(self.owned.shape)
        return np.where(self.owned, difference, 0.0)


def create_dirichlet(V: fem.FunctionSpace, bcs: list[fem.DirichletBC]) -> Dirichlet:
    """Find the prescribed dofs; a ValueError for invalid ones; collective."""
    supports = Dirichlet(V, bcs, prescribed_dofs(V, bcs))
    supports.values()
    return supports


def check_targets(solid: Solid, target: Floats) -> None:
    """Raise a ValueError on all ranks for values (dofs,) that leave the axis; collective."""
    V, i = solid.V, solid.kinematics.radius
    if i is None:
        return
    radial = target.reshape(-1, V.dofmap.index_map_bs)[:, i]
    axis = on_axis(solid.kinematics, V.mesh, V.tabulate_dof_coordinates()[: len(radial)])
    largest = float(maximum(V.mesh.comm, np.abs(target).max(initial=0.0))[0])
    leaving = axis & (np.abs(radial) > ROUND_OFF * largest)  # round-off of interpolation
    moved = V.mesh.comm.allreduce(int(np.sum(leaving)), op=MPI.SUM)
    if moved:
        raise ValueError(
            f"bcs: {moved} nodes on the axis r = 0 are prescribed to leave it, which opens a hole "
            f"in the body; prescribe 0 on V.sub({i}) there"
        )
