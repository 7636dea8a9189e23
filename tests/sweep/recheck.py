# SPDX-License-Identifier: MIT
"""Is a solved step one? Judged from assemble_mortar, solid.stress and contact.pressure alone.

Except for the heights of smooth surfaces over facets, which the gap is measured to.
"""

from __future__ import annotations

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

import dolfinx_mortar as dm
import ufl
from dolfinx import fem, la
from tests.sweep.problems import RandomProblem

Floats = npt.NDArray[np.float64]
TINY = np.finfo(float).tiny
LEAST_NORMAL = 0.5
"""A contact acts where Dirichlet data leave that much of the slave normal."""
SYMMETRIC = {2: [[0, 3], [3, 1]], 3: [[0, 3, 5], [3, 1, 4], [5, 4, 2]]}
"""Where the components of a tensor stand among those of ``solid.stress``."""


def residuals(case: RandomProblem) -> dict[str, float]:
    """Return what a committed step leaves, each on its own scale; collective.

    "equilibrium": forces on free unknowns over the largest force; "gap": deepest overlap over the
    facets' size; "sign": largest tension over the largest pressure; "complementarity": largest
    product of pressure and gap over both scales; "force": resultant on the slave side against
    ``contact.force``, over the larger.
    """
    comm = case.problem.V.mesh.comm
    internal, external = _stress_forces(case), _loads(case)
    free = ~_fixed(case)
    contact_forces = np.zeros_like(internal)
    found: dict[str, float] = {"gap": 0.0, "sign": 0.0, "complementarity": 0.0, "force": 0.0}
    for contact, sides in zip(case.problem.contacts, case.sides, strict=True):
        forces, worst = _contact(case, contact, sides, free)
        contact_forces += forces
        found = {name: max(value, worst[name]) for name, value in found.items()}
    stiffest = max(law.E for law in case.data["laws"].values())
    sizes = [np.abs(a).max(initial=0.0) for a in (internal, external, contact_forces)]
    sizes.append(1e-9 * stiffest * _travel(case))
    rest = np.abs((internal + contact_forces - external)[free]).max(initial=0.0)
    scale, rest = (comm.allreduce(float(a), op=MPI.MAX) for a in (max(sizes), rest))
    return {"equilibrium": rest / max(scale, TINY)} | found


def _travel(case: RandomProblem) -> float:
    """Return the largest displacement, at most the size of the mesh.

    It makes a scale for steps without forces. A body that has flown away must not make a larger one
    and so excuse whatever force is left.
    """
    mesh = case.problem.V.mesh
    local = (np.abs(case.problem.u.x.array), np.abs(mesh.geometry.x))
    return min(mesh.comm.allreduce(float(a.max(initial=0.0)), op=MPI.MAX) for a in local)


def _owned(case: RandomProblem) -> int:
    layout = case.problem.V.dofmap.index_map
    return case.problem.V.dofmap.index_map_bs * layout.size_local


def _assembled(case: RandomProblem, form: ufl.Form) -> Floats:
    """Return the owned entries of a linear form."""
    vector = fem.assemble_vector(fem.form(form))
    vector.scatter_reverse(la.InsertMode.add)
    return np.array(vector.array[: _owned(case)])


def stress_tensor(case: RandomProblem) -> ufl.core.expr.Expr:
    """Return the part of solid.stress that works on the displacement, (d, d)."""
    s = case.problem.solid.stress
    places = SYMMETRIC[case.problem.V.mesh.geometry.dim]
    return ufl.as_tensor([[s[k] for k in row] for row in places])


def at_points(case: RandomProblem) -> ufl.Measure:
    """Return the measure of the points at which the stress is known, by cell tags."""
    degree = case.problem.solid.quadrature_degree
    rule = {"quadrature_degree": degree, "quadrature_scheme": "default"}
    mesh = case.problem.V.mesh
    return ufl.Measure("dx", mesh, metadata=rule, subdomain_data=case.cell_tags)


def _stress_forces(case: RandomProblem) -> Floats:
    v = ufl.TestFunction(case.problem.V)
    strain = ufl.sym(ufl.grad(v))
    return _assembled(case, ufl.inner(stress_tensor(case), strain) * at_points(case))


def _loads(case: RandomProblem) -> Floats:
    return np.zeros(_owned(case)) if case.loads is None else _assembled(case, case.loads)


def _fixed(case: RandomProblem) -> npt.NDArray[np.bool_]:
    """Return which owned unknowns have Dirichlet data."""
    V = case.problem.V
    marks = la.vector(V.dofmap.index_map, V.dofmap.index_map_bs)
    marks.array[:] = 0.0
    for bc in case.bcs:
        marks.array[bc.dof_indices()[0]] = 1.0
    marks.scatter_reverse(la.InsertMode.add)
    return np.asarray(marks.array[: _owned(case)] > 0.0)


def _contact(
    case: RandomProblem, contact: dm.Contact, sides: tuple[int, int], free: npt.NDArray[np.bool_]
) -> tuple[Floats, dict[str, float]]:
    """Return the forces of a contact on the unknowns, and what is wrong with it."""
    problem = case.problem
    V, d = problem.V, problem.V.mesh.geometry.dim
    u = problem.u if problem.geometry == "updated" else None
    mortar = dm.assemble_mortar(V, case.facet_tags, slave=sides[0], master=sides[1], u=u)
    B = mortar.D - mortar.M
    nodes = mortar.nodes - V.dofmap.index_map.local_range[0]
    normals = mortar.N.getValuesCSR()[2].reshape(-1, d) * free.reshape(-1, d)[nodes]
    length = np.linalg.norm(normals, axis=1)
    acts = length >= LEAST_NORMAL
    normals = normals / np.maximum(length, TINY)[:, None]
    pressure = np.where(acts, contact.pressure.x.array[nodes], 0.0)
    weight = _row_norms(mortar.D)[::d]
    apart = -(normals * _apply(B, _current(case)).reshape(-1, d)).sum(axis=1)
    gap = (apart - _heights(case, contact)[nodes]) / weight
    tractions = (normals * pressure[:, None]).ravel()
    worst = _complementarity(V.mesh.comm, pressure[acts], gap[acts], weight, d)
    resultant = -_apply(mortar.D, tractions, transposed=True).reshape(-1, d).sum(axis=0)
    total = V.mesh.comm.allreduce(resultant, op=MPI.SUM)
    size = max(np.abs(total).max(), np.abs(contact.force).max(), TINY)
    force = float(np.abs(total - contact.force).max() / size)
    return _apply(B, tractions, transposed=True), worst | {"force": force}


def _heights(case: RandomProblem, contact: dm.Contact) -> Floats:
    """Return int Phi_j (h_s + h_m), by which smooth surfaces are nearer, at the owned nodes."""
    result = np.zeros(case.problem.n)
    for link in case.problem.system.links:
        if link.interface is contact:
            result[link.nodes] = link.coupling.weight[:, 0] * link.coupling.heights
    return result


def _complementarity(
    comm: MPI.Comm, pressure: Floats, gap: Floats, weight: Floats, d: int
) -> dict[str, float]:
    """Return the violations of gap >= 0, pressure >= 0, pressure gap = 0."""
    weights = np.concatenate(comm.allgather(weight))
    facet = float(np.median(weights)) ** (1.0 / (d - 1)) if len(weights) else 1.0
    local = (np.abs(pressure), -gap, -pressure, np.abs(pressure * gap))
    largest, deepest, tension, product = (
        comm.allreduce(float(a.max(initial=0.0)), op=MPI.MAX) for a in local
    )
    largest = max(largest, TINY)
    return {
        "gap": deepest / facet,
        "sign": tension / largest,
        "complementarity": product / (largest * facet),
    }


def _current(case: RandomProblem) -> Floats:
    """Return X + u of the owned unknowns."""
    V, own = case.problem.V, _owned(case)
    X = V.tabulate_dof_coordinates()[:, : V.mesh.geometry.dim].ravel()
    return np.asarray(X[:own] + case.problem.u.x.array[:own])


def _apply(A: PETSc.Mat, x: Floats, *, transposed: bool = False) -> Floats:
    """Return the owned entries of A x or A^T x; collective."""
    right, left = A.createVecs()
    given, result = (left, right) if transposed else (right, left)
    given.array[:] = x
    (A.multTranspose if transposed else A.mult)(given, result)
    return np.array(result.array_r)


def _row_norms(A: PETSc.Mat) -> Floats:
    """Return the Euclidean norms of the owned rows."""
    start, _, values = A.getValuesCSR()
    rows = np.repeat(np.arange(len(start) - 1), np.diff(start))
    return np.asarray(np.sqrt(np.bincount(rows, values**2, minlength=len(start) - 1)))
