# SPDX-License-Identifier: MIT
"""The mass matrix M* = D P^T M P D, with massless contact nodes (theory.md, Motion in time)."""

from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations_with_replacement
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import scipy

import ufl
from dolfinx import fem
from dolfinx.fem import petsc as fem_petsc
from dolfinx_mortar.algebra.csr import matrix_of, owned_rows
from dolfinx_mortar.algebra.parallel import maximum, values_at
from dolfinx_mortar.common.arrays import HALF_OF_DIGITS, ROUND_OFF, SAME, Bools, Floats, Ints

LEAST_FACTOR = 0.5
"""Smallest value of 1 + s at a node. Where it would be smaller, layers are too few for the moments
of inertia: of three inner layers the one in the middle would get none."""
NEWTON = 8
"""How many steps are tried for the moments of a body; those that can be restored take three."""
RINGS = 3
"""How many cells deep an inner node is looked for, at corners between sides that can open.

In the tip of a wedge of triangles it is two edges away, in that of a tetrahedron three, one for
each of the faces that meet there; inside, one edge goes away from one of them. Whole skins of
cubes: with 1 tetrahedra and triangles keep mass at corners and edges, with 2 to 12 nothing does.
"""


@dataclass(frozen=True)
class Mass:
    """The mass matrix M* of each displacement component; values are (owned nodes, d)."""

    matrix: PETSc.Mat
    X: Floats  # (owned nodes, d)
    massless: Bools  # (owned nodes,)
    extension: PETSc.Mat | None = None  # P, None for the identity

    def times(self, values: Floats) -> Floats:
        """Return M* v; collective."""
        return _apply(self.matrix, values)

    def extend(self, values: Floats) -> Floats:
        """P v; collective."""
        return values if self.extension is None else _apply(self.extension, values)

    def inner(self, forces: Floats) -> Floats:
        """P^T f, the forces on the nodes with mass; collective."""
        P = self.extension
        return forces if P is None else _apply(P, forces, transposed=True)

    def add_to(self, K: PETSc.Mat, factor: float) -> None:
        """Add factor M* to each component of K, within its pattern."""
        indptr, columns, values = self.matrix.getValuesCSR()
        blocks = factor * values[:, None, None] * np.eye(self.X.shape[1])
        K.setValuesBlockedIJV(indptr, columns, blocks.ravel(), addv=PETSc.InsertMode.ADD_VALUES)

    def solve(self, values: Floats, held: Bools) -> Floats:
        """Return P v, M* v = f at nodes with mass, v = 0 where held (owned nodes, d); collective.

        Raises:
            RuntimeError: on all ranks, if conjugate gradients do not converge.
        """
        matrix, free = self.matrix, ~(held | self.massless[:, None])
        first, result = matrix.getOwnershipRange()[0], np.zeros_like(values)
        for k, on in enumerate(free.T):
            rows = (np.flatnonzero(on) + first).astype(PETSc.IntType)
            chosen = PETSc.IS().createGeneral(rows, comm=matrix.comm)
            solver = PETSc.KSP().create(matrix.comm)
            solver.setOperators(matrix.createSubMatrix(chosen, chosen))
            solver.setType("cg")
            solver.getPC().setType("jacobi")
            solver.setTolerances(rtol=ROUND_OFF, atol=0.0)
            b, x = solver.getOperators()[0].createVecs()
            b.array[:] = values[on, k]
            solver.solve(b, x)
            if (reason := solver.getConvergedReason()) <= 0:
                raise RuntimeError(
                    f"Inertia: conjugate gradients found no initial acceleration along {'xyz'[k]} "
                    f"for the forces at the start, whose norm is {b.norm():.3g} (PETSc reason "
                    f"{reason}, after {solver.getIterationNumber()} iterations): check that the "
                    "terms of the problem give finite forces there"
                )
            result[on, k] = x.array_r
        return self.extend(result)

    def couplings(self, plain: PETSc.Mat) -> list[Ints]:
        """Blocks of dofs that M* couples beyond the consistent mass."""
        d, first = self.X.shape[1], plain.getOwnershipRange()[0]
        patterns = owned_rows(self.matrix), owned_rows(plain)
        for pattern in patterns:
            pattern.data[:] = 1.0
        beyond = patterns[0] > patterns[1]
        found = []
        for row in np.flatnonzero(np.diff(beyond.indptr)):
            nodes = np.append(beyond.indices[slice(*beyond.indptr[row : row + 2])], first + row)
            dofs = (d * nodes[:, None] + np.arange(d)).ravel()
            found.append(dofs.astype(PETSc.IntType))
        return found


def assemble_mass(V: fem.FunctionSpace, density: Any, weight: Any) -> Mass:
    """Assemble int rho N_i N_j weight dx; collective."""
    scalar = V.sub(0).collapse()[0]
    v, w = ufl.TrialFunction(scalar), ufl.TestFunction(scalar)
    matrix = fem_petsc.assemble_matrix(fem.form(density * weight * v * w * ufl.dx))
    matrix.assemble()
    n, d = V.dofmap.index_map.size_local, V.dofmap.index_map_bs
    return Mass(matrix, V.tabulate_dof_coordinates()[:n, :d], np.zeros(n, dtype=bool))


def relieve(plain: Mass, contact: Bools, body: Ints) -> Mass:
    """The mass without contact nodes (owned nodes,), given numbers of bodies; collective.

    With less than four layers of nodes, moments of inertia change; with one or two, all nodes keep
    their mass, as do nodes without an inner node within three cells.
    """
    comm = plain.matrix.comm.tompi4py()
    degree = np.full(comm.allreduce(int(body.max(initial=-1)), op=MPI.MAX) + 1, 2)
    while True:
        if not comm.allreduce(bool(contact.any()), op=MPI.LOR):
            return plain
        extension, massless = _extension(plain, contact)
        moved = plain.matrix.ptap(extension)
        scale, restored = _restore_moments(plain, moved, body, degree)
        if restored.all():
            break
        degree = np.where(restored, degree, degree - 1)
        contact = contact & (degree > 0)[body]
    v = moved.createVecRight()
    v.array[:] = scale
    moved.diagonalScale(v, v)
    return replace(plain, matrix=moved, extension=extension, massless=massless)


def _sum_by_body(comm: MPI.Intracomm, body: Ints, count: int, values: Floats) -> Floats:
    sums = np.zeros((count, values.shape[1]))
    np.add.at(sums, body, values)
    return np.asarray(comm.allreduce(sums))


def _extension(plain: Mass, contact: Bools) -> tuple[PETSc.Mat, Bools]:
    """P, and the contact nodes that have an inner node; collective."""
    M, n, inside = plain.matrix, len(contact), np.flatnonzero(contact)
    first, least = M.getOwnershipRange()[0], np.full(n, np.inf)
    at = PETSc.IS().createGeneral((inside + first).astype(PETSc.IntType), comm=M.comm)
    near = M.createSubMatrix(at, PETSc.IS().createStride(n, first=first, step=1, comm=M.comm))
    for _ in range(1, RINGS):
        near = near.matMult(M)
    indptr, column, _ = near.getValuesCSR()
    row, (wanted, place) = inside.repeat(np.diff(indptr)), np.unique(column, return_inverse=True)
    there = values_at(M.comm, np.column_stack([plain.X, contact]), wanted)[place]
    inner = there[:, -1] == 0.0
    row, column = row[inner], column[inner]
    distance = np.linalg.norm(there[inner, :-1] - plain.X[row], axis=1)
    np.minimum.at(least, row, distance)
    nearest, rest = distance <= (1.0 + HALF_OF_DIGITS) * least[row], np.flatnonzero(np.isinf(least))
    row, column = np.append(row[nearest], rest), np.append(column[nearest], rest + first)
    shares = 1.0 / np.bincount(row, minlength=n)[row]
    P = scipy.sparse.csr_array((shares, (row, column)), shape=(n, M.getSize()[1]))
    return matrix_of(M.comm, P, M.getLocalSize()[1]), np.isfinite(least)


def _restore_moments(
    plain: Mass, moved: PETSc.Mat, body: Ints, degree: Ints
) -> tuple[Floats, Bools]:
    """Diagonal of D by Newton's method, and the bodies with all moments of M."""
    comm, count = moved.comm.tompi4py(), len(degree)
    by_body = partial(_sum_by_body, comm, body, count)
    n, d = plain.X.shape
    mean = by_body(np.column_stack([np.ones(n), plain.X]))
    x = plain.X - (mean[:, 1:] / mean[:, :1])[body]
    size = np.sqrt(by_body((x**2).sum(axis=1)[:, None])[:, 0] / mean[:, 0])
    p = np.column_stack([np.ones(n), x / size[body][:, None]])
    pairs = list(combinations_with_replacement(range(d + 1), 2))
    q = np.stack([p[:, a] * p[:, b] for a, b in pairs], axis=1)
    # degree of s: 2 for all moments, 1 for mass and centre (the first pairs), 0 for none
    used = np.arange(len(pairs)) < np.choose(degree, [0, d + 1, len(pairs)])[:, None]

    def moments(left: Floats, right: Floats) -> Floats:
        return by_body(np.stack([left[:, a] * right[:, b] for a, b in pairs], axis=1))

    wanted = moments(p, _apply(plain.matrix, p))
    s, rest = np.zeros(n), np.full(count, np.inf)
    for _ in range(NEWTON):
        scaled = (1.0 + s)[:, None] * p
        image = _apply(moved, scaled)
        missing = np.where(used, wanted - moments(scaled, image), 0.0)
        rest = np.abs(missing).max(axis=1) / wanted[:, 0]
        if (rest < SAME).all():
            break
        changes = [q[:, k, None] * p for k in range(len(pairs))]
        slopes = np.stack([moments(c, image) + moments(image, c) for c in changes], axis=2)
        slopes *= used[:, :, None] & used[:, None]
        steps = np.linalg.pinv(slopes, HALF_OF_DIGITS) @ missing[:, :, None]
        s += (q * steps[body, :, 0]).sum(axis=1)
    least = np.full(count, np.inf)
    heavy = moved.getDiagonal().array_r > 0.0
    np.minimum.at(least, body[heavy], 1.0 + s[heavy])
    enough = -maximum(comm, *-least) > LEAST_FACTOR
    return np.asarray(1.0 + s), np.asarray((rest < SAME) & enough)


def _apply(matrix: PETSc.Mat, values: Floats, *, transposed: bool = False) -> Floats:
    x, y = matrix.createVecs()
    result = np.empty_like(values)
    for k in range(values.shape[1]):
        x.array[:] = values[:, k]
        (matrix.multTranspose if transposed else matrix.mult)(x, y)
        result[:, k] = y.array_r
    return result
