# SPDX-License-Identifier: MIT
"""Is a solved step one? Judged from assemble_mortar, solid.stress and contact.pressure alone.

Except for the heights of smooth surfaces over facets, which the gap is measured to, and for
normals, of which those on planes of symmetry depend on supports.
"""

from mpi4py import MPI

import numpy as np

import dolfinx_mortar as dm
import ufl
from dolfinx import fem, la
from tests.cases.solid import largest
from tests.sweep import slips

TINY = np.finfo(float).tiny
ON_AXIS = 1e-12  # of the coordinates
LEAST_NORMAL = 0.1
"""A contact acts where Dirichlet data leave that much of the slave normal."""
NO_PRESSURE = 1e-10
"""What is below this share of the stiffest modulus is round-off, of bodies that have parted."""
LEAST_STEP = 1e-2
"""Slips are measured by the largest motion in the step, or this share of all until now."""
SYMMETRIC = {2: [[0, 3], [3, 1]], 3: [[0, 3, 5], [3, 1, 4], [5, 4, 2]]}
"""Where the components of a tensor stand among those of ``solid.stress``."""


def residuals(case, before=None, begun=0.0):
    """Return what a committed step leaves, each on its own scale; collective.

    "equilibrium": forces on free unknowns over the largest force; "gap": deepest overlap over the
    facets' size; "sign": largest tension over the largest pressure; "complementarity": largest
    product of pressure and gap over both scales; "force": resultant on the slave side against
    ``contact.force``, over the larger. With friction those of `slips.residuals`, too.

    Args:
        case: the problem.
        before: owned displacements that the step started from; slips are read off the contact if
            they are not known, or the geometry is updated.
        begun: largest force at the begin of the step: of bodies that part nothing else is left.
    """
    internal, external = _stress_forces(case), _loads(case)
    free = ~_fixed(case)
    contact_forces = np.zeros_like(internal)
    found = {"gap": 0.0, "sign": 0.0, "complementarity": 0.0, "force": 0.0}
    for contact, sides in zip(case.problem.contacts, case.sides, strict=True):
        forces, worst = _contact(case, contact, sides, free, before, begun)
        contact_forces += forces
        found = {name: max(value, found.get(name, 0.0)) for name, value in worst.items()}
    scale = max(map(largest, (internal, external, contact_forces)))
    scale = max(scale, begun, 1e-9 * _stiffest(case) * _travel(case) * _length(case), TINY)
    rest = largest((internal + contact_forces - external)[free])
    return {"equilibrium": rest / scale} | found


def _stiffest(case):
    return max(map(_modulus, case.data["laws"].values()))


def _modulus(law):
    """Return Young's modulus of a law, the largest or about that."""
    for name in ("E", "E1", "K"):
        if hasattr(law, name):
            return getattr(law, name)
    raise AssertionError(f"{law!r} has no modulus")


def largest_force(case):
    """Return the largest force of the stress on an unknown; collective."""
    return largest(_stress_forces(case))


def _length(case):
    """Return the largest circumference of rings, 1 of others; collective.

    Forces of rings are those of the whole circumference, of plane problems per thickness: modulus
    times displacement is a force of the latter only.
    """
    x = case.problem.V.mesh.geometry.x
    return 2 * np.pi * largest(x[:, 0]) if is_ring(case) else 1.0


def _travel(case):
    """Return the largest displacement, at most the size of the mesh.

    It makes a scale for steps without forces. A body that has flown away must not make a larger one
    and so excuse whatever force is left.
    """
    return min(map(largest, (case.problem.u.x.array, case.problem.V.mesh.geometry.x)))


def _owned(case):
    layout = case.problem.V.dofmap.index_map
    return case.problem.V.dofmap.index_map_bs * layout.size_local


def _assembled(case, form):
    """Return the owned entries of a linear form."""
    vector = fem.assemble_vector(fem.form(form))
    vector.scatter_reverse(la.InsertMode.add)
    return np.array(vector.array[: _owned(case)])


def stress_tensor(case):
    """Return the part of solid.stress that works on the displacement, (d, d)."""
    s = case.problem.solid.stress
    places = SYMMETRIC[case.problem.V.mesh.geometry.dim]
    return ufl.as_tensor([[s[k] for k in row] for row in places])


def at_points(case):
    """Return the measure of the points at which the stress is known, by cell tags."""
    degree = case.problem.solid.quadrature_degree
    rule = {"quadrature_degree": degree, "quadrature_scheme": "default"}
    mesh = case.problem.V.mesh
    return ufl.Measure("dx", mesh, metadata=rule, subdomain_data=case.cell_tags)


def _stress_forces(case):
    u, v = case.problem.u, ufl.TestFunction(case.problem.V)
    r = ufl.SpatialCoordinate(case.problem.V.mesh)[0]
    F, hoop, J = ufl.Identity(case.problem.d), 1.0, 1.0
    if is_finite(case):  # Cauchy's stress works on the gradient at X + u
        F, hoop = F + ufl.grad(u), 1.0 + u[0] / r if is_ring(case) else 1.0
        J = ufl.det(F) * hoop
    work = J * ufl.inner(stress_tensor(case), ufl.grad(v) * ufl.inv(F))
    if is_ring(case):
        along = J * case.problem.solid.stress[2] * v[0] / (r * hoop)
        work = 2 * ufl.pi * r * (work + along)
    return _assembled(case, work * at_points(case))


def is_finite(case):
    """Tell whether the strains are finite."""
    return case.problem.solid.strain == "finite"


def is_ring(case):
    """Tell whether the bodies are axisymmetric."""
    return case.data.get("kinematics") == "axisymmetric"


def _circumference(x):
    return 2 * np.pi * x[:, 0]


def _loads(case):
    return np.zeros(_owned(case)) if case.loads is None else _assembled(case, case.loads)


def _fixed(case):
    """Return which owned unknowns have Dirichlet data."""
    V = case.problem.V
    marks = la.vector(V.dofmap.index_map, V.dofmap.index_map_bs)
    marks.array[:] = 0.0
    for bc in case.bcs:
        marks.array[bc.dof_indices()[0]] = 1.0
    marks.scatter_reverse(la.InsertMode.add)
    return marks.array[: _owned(case)] > 0.0


def _contact(
    case,
    contact,
    sides,
    free,
    before,
    begun,
):
    """Return the forces of a contact on the unknowns, and what is wrong with it."""
    problem = case.problem
    V, d = problem.V, problem.V.mesh.geometry.dim
    u = problem.u if problem.geometry == "updated" else None
    weight = _circumference if is_ring(case) else None
    link = problem.system.link(contact)
    pair = {"slave": sides[0], "master": sides[1], "u": u}
    pair["feature_angle"] = contact.feature_angle
    mortar = dm.assemble_mortar(V, case.facet_tags, weight=weight, **pair)
    B = mortar.D - mortar.M
    nodes = mortar.nodes - V.dofmap.index_map.local_range[0]
    loose = free.reshape(-1, d)[nodes]
    used = np.zeros((problem.n, d))
    used[link.nodes] = link.coupling.normals
    normals = used[nodes]
    acts = np.linalg.norm(normals * loose, axis=1) >= LEAST_NORMAL
    pressure = np.where(acts, contact.pressure.x.array[nodes], 0.0)
    weight = _row_norms(mortar.D)[::d]
    apart = -(normals * _apply(B, _current(case)).reshape(-1, d)).sum(axis=1)
    gap = (apart - _heights(case, contact)[nodes]) / weight
    tractions = (normals * pressure[:, None]).ravel()
    if case.limit is not None:
        tractions -= contact.traction.x.array.reshape(-1, d)[nodes].ravel()
    size = weight
    if is_ring(case):  # of the section, not of what it sweeps
        tractions *= np.repeat(_growth(case, contact, nodes), d)
        plain = dm.assemble_mortar(V, case.facet_tags, **pair)
        size = _row_norms(plain.D)[::d]
    floor = NO_PRESSURE * _stiffest(case)
    worst = _complementarity(V.mesh.comm, pressure[acts], gap[acts], size, d, floor)
    if case.limit is not None:
        # with updated geometry the slave side carries along what is apart when it turns, so that
        # slips are objective: there they are read off the contact
        way = None
        if before is not None and case.problem.geometry == "reference":
            moved = case.problem.u.x.array[: _owned(case)] - before
            way = _apply(B, moved).reshape(-1, d) / weight[:, None]
        travel = _travel_of(case, before)
        at = slips.Nodes(nodes, normals, loose, acts, pressure, case.limit.x.array[nodes])
        worst |= slips.residuals(contact, at, way, travel, floor, begun / largest(weight))
    resultant = -_apply(mortar.D, tractions, transposed=True).reshape(-1, d).sum(axis=0)
    total = V.mesh.comm.allreduce(resultant, op=MPI.SUM)
    size = max(np.abs(total).max(), np.abs(contact.force).max(), TINY)
    force = float(np.abs(total - contact.force).max() / size)
    return _apply(B, tractions, transposed=True), worst | {"force": force}


def _growth(case, contact, nodes):
    """Return how much longer the circumference is than at X, 1 for held geometry; see D's weight.

    On the axis it is that of the nearest slave node.
    """
    if case.problem.geometry == "reference":
        return np.ones(len(nodes))
    every = contact.gather(case.problem.u)
    X, x = every["X"], every["x"][:, 0]
    off = np.flatnonzero(X[:, 0] > ON_AXIS * np.abs(X).max())
    own = case.problem.V.tabulate_dof_coordinates()[nodes, :2]
    nearest = off[[np.argmin(((X[off] - at) ** 2).sum(axis=1)) for at in own]]
    return x[nearest] / X[nearest, 0]


def _travel_of(case, before):
    """Return the largest motion of a node in the step, or a hundredth of all until now."""
    u = case.problem.u.x.array[: _owned(case)]
    step = 0.0 if before is None else largest(u - before)
    return max(step, LEAST_STEP * largest(u))


def _heights(case, contact):
    """Return int Phi_j (h_s + h_m), by which smooth surfaces are nearer, at the owned nodes."""
    result = np.zeros(case.problem.n)
    for link in case.problem.system.links:
        if link.interface is contact:
            result[link.nodes] = link.coupling.weight[:, 0] * link.coupling.heights
    return result


def _complementarity(comm, pressure, gap, size, d, floor):
    """Return the violations of gap >= 0, pressure >= 0, pressure gap = 0.

    The sizes are those of what belongs to the nodes, lengths or areas; the floor is a pressure.
    """
    sizes = np.concatenate(comm.allgather(size))
    facet = float(np.median(sizes)) ** (1.0 / (d - 1)) if len(sizes) else 1.0
    local = (np.abs(pressure), -gap, -pressure, np.abs(pressure * gap))
    most, deepest, tension, product = (
        comm.allreduce(float(a.max(initial=0.0)), op=MPI.MAX) for a in local
    )
    most = max(most, floor)
    return {
        "gap": deepest / facet,
        "sign": tension / most,
        "complementarity": product / (most * facet),
    }


def _current(case):
    """Return X + u of the owned unknowns."""
    V, own = case.problem.V, _owned(case)
    X = V.tabulate_dof_coordinates()[:, : V.mesh.geometry.dim].ravel()
    return X[:own] + case.problem.u.x.array[:own]


def _apply(A, x, *, transposed=False):
    """Return the owned entries of A x or A^T x; collective."""
    right, left = A.createVecs()
    given, result = (left, right) if transposed else (right, left)
    given.array[:] = x
    (A.multTranspose if transposed else A.mult)(given, result)
    return np.array(result.array_r)


def _row_norms(A):
    """Return the Euclidean norms of the owned rows."""
    start, _, values = A.getValuesCSR()
    rows = np.repeat(np.arange(len(start) - 1), np.diff(start))
    return np.sqrt(np.bincount(rows, values**2, minlength=len(start) - 1))
