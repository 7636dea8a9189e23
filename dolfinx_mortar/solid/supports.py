# SPDX-License-Identifier: MIT
"""Connected parts of a mesh, their unconstrained rigid-body modes, and Dirichlet conditions."""

import dataclasses
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt
import scipy

from dolfinx import fem, la
from dolfinx_mortar.algebra.parallel import maximum, raised_together
from dolfinx_mortar.common.arrays import (
    HALF_OF_DIGITS,
    QUARTER_OF_DIGITS,
    ROUND_OFF,
    TINY,
    Bools,
    Floats,
    Ints,
)
from dolfinx_mortar.common.spaces import connected_parts, with_ghosts
from dolfinx_mortar.geometry import tolerances
from dolfinx_mortar.solid.kinematics import on_axis, translations_and_rotations
from dolfinx_mortar.solid.solid import Solid

Motion = Callable[[PETSc.Vec], Floats]
Modes = list[tuple[int, str, PETSc.Vec]]


@dataclass(frozen=True)
class Bodies:
    """Connected parts of a mesh."""

    V: fem.FunctionSpace
    count: int
    label: Ints  # (owned nodes,) body of each node
    centre: Floats  # (count, d) mean of the nodes' coordinates
    radius: Floats  # (count,) rms distance of the nodes from it
    motions: Callable[[Floats], dict[str, Floats]] = translations_and_rotations  # see `Kinematics`
    group: Ints | None = None  # (count,) common number of tied bodies

    def rigid_modes(self) -> Modes:
        """Return (body, name, displacement) of every rigid motion, rotations scaled by 1/radius."""
        d = self.V.dofmap.index_map_bs
        x = self.V.tabulate_dof_coordinates()[: len(self.label), :d]
        modes = []
        for body in range(self.count):
            on = (self.label == body)[:, None]
            arm = (x - self.centre[body]) / self.radius[body]
            motions = self.motions(arm)
            modes += [(body, name, self._vector(m * on)) for name, m in motions.items()]
        return modes

    @property
    def groups(self) -> Ints:
        """Common number (count,) of tied bodies, see `with_ties`."""
        return np.arange(self.count, dtype=np.int32) if self.group is None else self.group

    @cached_property
    def of_cells(self) -> Ints:
        """Body (owned cells,) of each cell; collective."""
        V = self.V
        owned = V.mesh.topology.index_map(V.mesh.topology.dim).size_local
        return with_ghosts(V, self.label)[V.dofmap.list[:owned, 0]]

    @property
    def shifts(self) -> Bools:
        """Mask (d,) of strain-free translations."""
        d = self.V.dofmap.index_map_bs
        probes = np.vstack([np.zeros(d), np.eye(d)])
        motions = [motion.ravel() for motion in self.motions(probes).values()]
        if not motions:
            return np.zeros(d, dtype=bool)
        basis, shifts = np.stack(motions, axis=1), np.tile(np.eye(d), (d + 1, 1))
        left = shifts - basis @ np.linalg.lstsq(basis, shifts)[0]
        return np.asarray(np.abs(left).max(axis=0) < QUARTER_OF_DIGITS)

    def _vector(self, values: Floats) -> PETSc.Vec:
        layout, d = self.V.dofmap.index_map, self.V.dofmap.index_map_bs
        vector = PETSc.Vec().createMPI(
            (d * layout.size_local, d * layout.size_global), bsize=d, comm=self.V.mesh.comm
        )
        vector.array[:] = values.ravel()
        return vector

    def turned(self, asked: Floats, where: Bools, x: Floats) -> Floats:
        """Displacements (owned nodes, d) by rotations beyond the mean increments; collective.

        Of bodies (tied ones together) whose prescribed nodes, not all on a line, move rigidly from
        x to x + asked; zero for others.
        """
        comm, d, result = self.V.mesh.comm, x.shape[1], np.zeros_like(x)
        group = self.groups
        label, whole = group[self.label], where.all(axis=1)
        some = where.any(axis=1) & ~whole
        partly = maximum(comm, *np.bincount(label[some], minlength=self.count))
        for k in np.unique(group):
            on = whole & (label == k)
            sums = np.array([on.sum(), *x[on].sum(axis=0), *asked[on].sum(axis=0)])
            sums = comm.allreduce(sums, op=MPI.SUM)
            if sums[0] == 0.0 or partly[k]:
                continue
            centre, shift = sums[1 : d + 1] / sums[0], sums[d + 1 :] / sums[0]
            arms = x[on] - centre
            ends = arms + asked[on] - shift
            U, S, Vt = np.linalg.svd(comm.allreduce(ends.T @ arms, op=MPI.SUM))
            signs = np.ones(d)
            signs[-1] = np.linalg.det(U @ Vt)
            Q = (U * signs) @ Vt
            miss = np.abs(ends - arms @ Q.T).max(initial=0.0)
            miss, size = maximum(comm, miss, np.abs(arms).max(initial=0.0))
            if S[d - 2] > HALF_OF_DIGITS * S[0] > 0.0 and miss <= HALF_OF_DIGITS * size:
                own = label == k
                result[own] = (x[own] - centre) @ (Q - np.eye(d)).T
        return result

    def mean(self, values: Floats, where: Bools) -> Floats:
        """Mean of marked values (owned nodes, d) over (tied) bodies, else 0; collective."""
        total = np.zeros((self.count, 2, values.shape[1]))
        np.add.at(total[:, 0], self.label, np.where(where, values, 0.0))
        np.add.at(total[:, 1], self.label, where.astype(float))
        total = self.V.mesh.comm.allreduce(total, op=MPI.SUM)
        if self.group is not None:
            for k in range(self.group.max() + 1):
                total[self.group == k] = total[self.group == k].sum(axis=0)
        return total[:, 0] / np.maximum(total[:, 1], 1.0)


def find_bodies(
    V: fem.FunctionSpace,
    motions: Callable[[Floats], dict[str, Floats]] = translations_and_rotations,
) -> Bodies:
    """Connected parts of the mesh, with ``motions`` as rigid-body modes; collective."""
    count, label = connected_parts(V)
    label = label[: V.dofmap.index_map.size_local]
    return dataclasses.replace(_measure(V, count, label), motions=motions)


def with_ties(bodies: Bodies, ties: Sequence[Bools]) -> Bodies:
    """Bodies grouped by ties, each the mask (local nodes,) of its two sides; collective."""
    touched = bodies_of(bodies, ties)
    _, group = scipy.sparse.csgraph.connected_components(touched.T @ touched, directed=False)
    return dataclasses.replace(bodies, group=np.asarray(group, dtype=np.int32))


def bodies_of(bodies: Bodies, masks: Sequence[Bools]) -> Floats:
    """Ranks (masks, bodies) on which masks (local nodes,) have nodes of bodies; collective."""
    touched = np.zeros((len(masks), bodies.count))
    for k, mask in enumerate(masks):
        touched[k, bodies.label[mask[: len(bodies.label)]]] = 1.0
    return np.asarray(bodies.V.mesh.comm.allreduce(touched, op=MPI.SUM))


def _measure(V: fem.FunctionSpace, count: int, label: Ints) -> Bodies:
    d = V.dofmap.index_map_bs
    x = V.tabulate_dof_coordinates()[: len(label), :d]
    bodies = Bodies(V, count, label, np.zeros((count, d)), np.ones(count))
    centre = bodies.mean(x, np.ones_like(x, dtype=bool))
    square = bodies.mean((x - centre[label]) ** 2, np.ones_like(x, dtype=bool))
    return Bodies(V, count, label, centre, np.sqrt(square.sum(axis=1)))


def rigid_motions(bodies: Bodies) -> list[PETSc.Vec]:
    """Rigid motions of the whole mesh as one body; collective."""
    everything = np.zeros_like(bodies.label)
    whole = dataclasses.replace(_measure(bodies.V, 1, everything), motions=bodies.motions)
    return [motion for _, _, motion in whole.rigid_modes()]


def find_free(
    bodies: Bodies,
    constraints: Sequence[Motion],
    contacts: Sequence[Motion] = (),
    facets: Sequence[Motion] = (),
) -> tuple[list[str], list[str]]:
    """Names of the rigid-body modes that no constraint resists, with and without contacts.

    Motions of single bodies where possible, then of several together, then sums; collective.

    Args:
        constraints: linear functions of a displacement vector that return constrained displacements
            (any number on each rank).
        contacts: such functions of contacts, as if they were bilateral.
        facets: such functions of resistance only by facets of a curved side, as of a spinning pin.
    """
    modes = bodies.rigid_modes()
    if not modes:
        return [], []
    held, touching, uneven = (_gram(bodies, modes, f) for f in (constraints, contacts, facets))
    none = np.zeros_like(held)
    with_contacts = _name_free(bodies, modes, held, touching, uneven)
    return with_contacts, _name_free(bodies, modes, held, none, none)


def _name_free(
    bodies: Bodies, modes: Modes, held: Floats, touching: Floats, uneven: Floats
) -> list[str]:
    scale = max(float((held + touching).diagonal().max()), TINY)
    null = np.eye(len(modes))
    for form in (held, touching - uneven):
        if null.shape[1] == 0:
            return []
        values, vectors = np.linalg.eigh(null.T @ form @ null / scale)
        null = null @ vectors[:, values < ROUND_OFF * len(modes)]
    rest = null
    body = np.array([k for k, _, _ in modes])
    named = [f"{name} of {name_of(bodies, [k])}" for k, name, _ in modes]
    rest, found = _take_out(null, rest, dict(zip(named, np.eye(len(modes)), strict=True)))
    for group in _groups(rest, body):
        rest, together = _take_out(null, rest, _common_motions(bodies, group))
        found += together
    for motion in rest.T:
        parts = np.flatnonzero(np.abs(motion) > 0.1 * np.abs(motion).max())
        found.append(" + ".join(named[k] for k in parts))
    return found


def _gram(bodies: Bodies, modes: Modes, functions: Sequence[Motion]) -> Floats:
    """Sums (modes, modes) of f(v_a).f(v_b) over linear functions f; collective."""
    rows = np.zeros((0, len(modes)))
    if functions:
        columns = [np.concatenate([f(v).ravel() for f in functions]) for _, _, v in modes]
        rows = np.column_stack(columns)
    return np.asarray(bodies.V.mesh.comm.allreduce(rows.T @ rows, op=MPI.SUM))


def name_of(bodies: Bodies, group: list[int]) -> str:
    """Name of a body, or several, in messages."""
    size = bodies.radius[group].max()
    centre = np.where(
        np.abs(bodies.centre[group]) < QUARTER_OF_DIGITS * size, 0.0, bodies.centre[group]
    )
    places = sorted([float(f"{x:.4g}") for x in row] for row in centre)
    centres = ", ".join(map(str, places))
    return (
        f"the bodies around {centres} together" if len(group) > 1 else f"the body around {centres}"
    )


def _take_out(null: Floats, rest: Floats, motions: dict[str, Floats]) -> tuple[Floats, list[str]]:
    """Rest (modes, k) of a null space without given motions, and the contained ones."""
    found = []
    for name, motion in motions.items():
        unit = motion / np.linalg.norm(motion)
        share = rest.T @ unit
        inside = np.linalg.norm(unit - null @ (null.T @ unit)) < QUARTER_OF_DIGITS
        if inside and np.linalg.norm(share) > QUARTER_OF_DIGITS:
            found.append(name)
            rest = rest @ np.linalg.svd(share[None])[2][1:].T
    return rest, found


def _groups(null: Floats, body: npt.NDArray[np.int_]) -> list[list[int]]:
    linked = np.abs(null @ null.T) > QUARTER_OF_DIGITS
    _, label = scipy.sparse.csgraph.connected_components(
        linked | (body[:, None] == body), directed=False
    )
    return [np.unique(body[label == k]).tolist() for k in np.unique(label)]


def _common_motions(bodies: Bodies, group: list[int]) -> dict[str, Floats]:
    count, d = bodies.centre.shape
    middle = bodies.centre[group].mean(axis=0)
    probes = np.vstack([np.zeros(d), np.eye(d)])  # modes are affine
    own = bodies.motions(probes)
    basis = np.stack([motion.ravel() for motion in own.values()])
    motions = np.zeros((len(own), count, len(own)))
    for body in group:
        at = bodies.centre[body] + bodies.radius[body] * probes - middle
        wanted = np.stack([motion.ravel() for motion in bodies.motions(at).values()])
        motions[:, body] = np.linalg.lstsq(basis.T, wanted.T)[0].T
    who = name_of(bodies, group)
    return {f"{n} of {who}": m.ravel() for n, m in zip(own, motions, strict=True)}


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
        return self.fixed[: self.V.dofmap.index_map.size_local]

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
        sizes = maximum(comm, *(np.abs(v).max(initial=0.0) for v in (X, given)))
        allowed = tolerances.ROUND_OFF * sizes.sum()
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
    leaving = axis & (np.abs(radial) > tolerances.ROUND_OFF * largest)  # round-off of interpolation
    moved = V.mesh.comm.allreduce(int(np.sum(leaving)), op=MPI.SUM)
    if moved:
        raise ValueError(
            f"bcs: {moved} nodes on the axis r = 0 are prescribed to leave it, which opens a hole "
            f"in the body; prescribe 0 on V.sub({i}) there"
        )
