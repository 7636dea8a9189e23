# SPDX-License-Identifier: MIT
"""Integrals of a user's own over an interface: points of both sides, scalar D and M."""

import dataclasses

from mpi4py import MPI

import numpy as np
import pytest

import basix.ufl
import dolfinx
import dolfinx_mortar as dm
import ufl
from dolfinx import fem
from dolfinx.fem import petsc
from dolfinx_mortar.mortar import assembly
from tests.cases import meshes, meshes_3d
from tests.cases.meshes import BOTTOM_OF_UPPER, LOWER, TOP, TOP_OF_LOWER, UPPER
from tests.cases.mortar import largest, space
from tests.cases.pressed_blocks import rejected
from tests.choice import crosswise

COMM = MPI.COMM_WORLD
EXACT = 1e-12
CELLS = ["triangle", "quadrilateral", "tetrahedron", "hexahedron"]
SIDES = {"slave": TOP_OF_LOWER, "master": BOTTOM_OF_UPPER}
SWAPPED = {"slave": BOTTOM_OF_UPPER, "master": TOP_OF_LOWER}


def blocks(cell, comm=COMM, x_upper=(0.0, 1.0), width=1.0, **options):
    """Return two blocks that do not match, whose fine upper one covers `x_upper` of the width."""
    ends = tuple(width * x for x in x_upper)
    if cell in ("triangle", "quadrilateral"):
        sizes = {"x_lower": (0.0, width), "x_upper": ends}
        return meshes.two_blocks(comm, (3, 2), (5, 2), cell=cell, **sizes, **options)
    sizes = {"lower": (0.0, width, 0.0, width), "upper": (*ends, 0.0, width)}
    return meshes_3d.two_boxes(comm, (2, 2, 1), (3, 3, 1), cell=cell, **sizes, **options)


def scalars(mesh, degree):
    return fem.functionspace(mesh, ("Lagrange", degree))


def everywhere(V, values):
    return np.concatenate(V.mesh.comm.allgather(values[: V.dofmap.index_map.size_local]))


def positions(V, u=None):
    """Return X + u of all nodes; V and u have the same nodes."""
    d = V.mesh.geometry.dim
    moved = 0.0 if u is None else u.x.array.reshape(-1, d)
    return everywhere(V, V.tabulate_dof_coordinates()[:, :d] + moved)


def on_both(s, at_nodes):
    for dofs, N, G in (
        (s.slave_dofs, s.slave_values, s.slave_gradients),
        (s.master_dofs, s.master_values, s.master_gradients),
    ):
        yield np.einsum("nk,nk->n", N, at_nodes[dofs]), np.einsum("nki,nk->ni", G, at_nodes[dofs])


def moved(V, motion):
    """Return the displacement by which X gets to motion(X)."""
    d = V.mesh.geometry.dim
    u = fem.Function(V)
    u.interpolate(lambda x: motion(x[:d]) - x[:d])
    return u


def bent(x):
    waves = [0.1 * np.sin(2 * x[i - 1] + i) for i in range(len(x))]
    return x + np.stack(waves)


# -- points


@pytest.mark.mpi
@pytest.mark.parametrize(
    ("motion", "sides", "partition"), [(False, SIDES, "empty"), (True, SWAPPED, "bodies")]
)
@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("cell", CELLS)
def test_polynomials_are_exact_on_both_sides(cell, degree, motion, sides, partition):
    """Values, gradients, area, normal and gap, also after a rotation with a stretch."""
    mesh, _, tags = blocks(cell, x_upper=(0.3, 1.2), gap=0.1, partition=partition)
    d = mesh.geometry.dim
    F, V = np.eye(d), scalars(mesh, degree)
    if motion:
        F = 1.5 * (meshes_3d.rotation((1, 2, 3) if d == 3 else (0, 0, 1), 0.7)[:d, :d])
    u = moved(space(mesh, degree), lambda x: F @ x) if motion else None
    s = dm.segments(V, tags, **sides, u=u)
    stretch = np.linalg.norm(F, 2)
    assert abs(COMM.allreduce(s.weight.sum()) - 0.7 * stretch ** (d - 1)) < EXACT
    up = F[:, -1] / stretch * (1 if sides is SIDES else -1)
    assert largest(s.normal - up) < EXACT and largest(s.gap - 0.1 * stretch) < EXACT
    g, x_s, x = np.arange(1.0, d + 1), s.x, positions(V, u)
    for at, (values, gradients) in zip(
        (x_s, x_s + s.gap[:, None] * s.normal), on_both(s, (x @ g + 0.3) ** degree), strict=True
    ):
        assert largest(values - (at @ g + 0.3) ** degree) < 100 * EXACT
        slope = degree * (at @ g + 0.3) ** (degree - 1)
        assert largest(gradients - slope[:, None] * g) < 100 * EXACT
    for values, gradients in on_both(s, np.ones(len(x))):
        assert largest(values - 1.0) < EXACT and largest(gradients) < 10 * EXACT


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("cell", CELLS)
def test_linear_fields_are_exact_on_curved_sides(cell, order):
    """Also where the functions have a lower degree than the displacement and the cells."""
    bend = (lambda x: bent(x.T).T) if order == 2 else None
    mesh, _, tags = blocks(cell, order=order, transform=bend, partition="stripes")
    u = moved(space(mesh, 2), bent)
    low, high = (dm.segments(scalars(mesh, k), tags, **SIDES, u=u) for k in (1, 2))
    x = positions(scalars(mesh, 2), u)
    g = np.arange(1.0, x.shape[1] + 1)
    for values, gradients in on_both(high, x @ g):
        assert values.shape == high.weight.shape and largest(gradients - g) < 100 * EXACT
    x_s, x_m = zip(*((v for v, _ in on_both(high, column)) for column in x.T), strict=True)
    assert largest(np.stack(x_s, axis=1) - high.x) < EXACT
    off = np.stack(x_m, axis=1) - high.x
    assert largest((off * high.normal).sum(axis=1) - high.gap) < EXACT
    assert largest(np.linalg.norm(high.normal, axis=1) - 1) < EXACT
    assert largest(low.x - high.x) == largest(low.weight - high.weight) == 0.0


@pytest.mark.mpi
def test_dofs_and_cells_are_those_of_the_mesh():
    """Dofs of vectors are those of the components; cells are global, reference points in them."""
    mesh, cells, tags = blocks("hexahedron", partition="stripes")
    V = space(mesh, 2)
    s, of_scalars = dm.segments(V, tags, **SIDES), dm.segments(scalars(mesh, 2), tags, **SIDES)
    assert s.slave_dofs.shape == (len(s.x), 27, 3)
    assert (s.master_dofs == 3 * of_scalars.master_dofs[:, :, None] + np.arange(3)).all()
    assert (s.slave_dofs == 3 * of_scalars.slave_dofs[:, :, None] + np.arange(3)).all()
    first, last = mesh.topology.index_map(3).local_range
    assert (s.slave_cells >= first).all() and (s.slave_cells < last).all()
    values = np.zeros(last - first, dtype=np.int32)
    own = cells.indices < last - first
    values[cells.indices[own]] = cells.values[own]
    tag = np.concatenate(COMM.allgather(values))
    assert (tag[s.slave_cells] == LOWER).all() and (tag[s.master_cells] == UPPER).all()
    for xi in (s.xi_slave, s.xi_master):
        assert xi.shape == s.x.shape and (xi > -EXACT).all() and (xi < 1 + EXACT).all()


# -- D and M


def dense(A, V, rows):
    """Return a matrix on all ranks, its rows at nodes."""
    n = V.dofmap.index_map.size_global * V.dofmap.index_map_bs
    start, columns, values = A.getValuesCSR()
    result = np.zeros((n, n))
    result[np.repeat(rows, np.diff(start)), columns] = values
    return V.mesh.comm.allreduce(result)


@pytest.mark.parametrize(
    ("cell", "degree"),
    [(c, k) for c in CELLS for k in (1, 2) if (c, k) != ("tetrahedron", 2)],  # duals of N~
)
def test_D_and_M_are_sums_over_the_points(cell, degree):
    """The integrals of Phi_j N_l with Phi = D_e m_e^-1 N on each facet, all of it covered."""
    mesh, _, tags = blocks(cell, x_upper=(-0.2, 1.3), partition="stripes")
    V = scalars(mesh, degree)
    mortar, s = (f(V, tags, **SIDES) for f in (dm.assemble_mortar, dm.segments))
    n = V.dofmap.index_map.size_global
    D, M = np.zeros((n, n)), np.zeros((n, n))
    for cell_of_facet in np.unique(s.slave_cells):  # none has two facets here
        at = np.flatnonzero(s.slave_cells == cell_of_facet)
        N, w, dofs = s.slave_values[at], s.weight[at], s.slave_dofs[at[0]]
        on = np.abs(N).max(axis=0) > EXACT
        N, dofs = N[:, on], dofs[on]
        Phi = w[:, None] * N @ np.linalg.solve(N.T @ (w[:, None] * N), np.diag(w @ N))
        D[np.ix_(dofs, dofs)] += Phi.T @ N
        for q, p in zip(at, Phi, strict=True):
            M[np.ix_(dofs, s.master_dofs[q])] += np.outer(p, s.master_values[q])
    for mine, its in ((D, mortar.D), (M, mortar.M)):
        assert largest(COMM.allreduce(mine) - dense(its, V, mortar.nodes)) < EXACT
    assert mortar.N is None and mortar.gap is None


@pytest.mark.mpi
@pytest.mark.parametrize("degree", [1, 2])
def test_a_displacement_of_another_space_moves_the_sides_of_V(degree):
    """Of a lower degree, or a part of a mixed space, whose nodes have other numbers."""
    mesh, _, tags = blocks("triangle", partition="stripes")
    V = scalars(mesh, degree)
    u = fem.Function(mixed(mesh, degree).sub(0).collapse()[0])
    u.interpolate(lambda x: 0.1 * np.stack([x[1], x[0] + x[1]]))
    same = fem.Function(space(mesh, degree))
    same.interpolate(u)
    low = fem.Function(space(mesh, 1))
    low.interpolate(u)
    expected = dm.assemble_mortar(V, tags, **SIDES, u=same)
    for other in (u, low):
        found = dm.assemble_mortar(V, tags, **SIDES, u=other)
        for A, B in ((found.D, expected.D), (found.M, expected.M)):
            assert (A - B).norm() < EXACT < B.norm()


def mixed(mesh, degree):
    cell = mesh.basix_cell()
    vector = basix.ufl.element("P", cell, degree, shape=(mesh.geometry.dim,))
    return fem.functionspace(
        mesh, basix.ufl.mixed_element([vector, basix.ufl.element("P", cell, 1)])
    )


# -- conduction of heat


def bodywise(V, cells, fields):
    """Return a Function that is a function of points in each body, by its tag."""
    T = fem.Function(V)
    for tag, field in fields.items():
        T.interpolate(field, cells.find(tag))
    T.x.scatter_forward()
    return T


K = {LOWER: 50.0, UPPER: 20.0}


# h, flux, temperatures of the two sides
BARS = [
    (1e2, 13793.1, 172.414, 34.483),
    (1e3, 36363.6, 127.273, 90.909),
    (1e4, 43478.3, 113.043, 108.696),
]


@pytest.mark.mpi
@pytest.mark.parametrize(("cell", "degree"), crosswise(CELLS, [1, 2]))
def test_two_bars_in_series_with_a_resistance_between_them(cell, degree):
    """200 degrees over lengths of .1 and .05: q = 200 / (L1 / k1 + 1 / h + L2 / k2)."""
    mesh, cells, tags = blocks(cell, heights=(0.1, 0.05), width=0.03, partition="stripes")
    V, up = scalars(mesh, degree), mesh.geometry.dim - 1
    s = dm.segments(V, tags, **SIDES)
    dofs = np.hstack([s.slave_dofs, s.master_dofs])
    jump = np.hstack([s.slave_values, -s.master_values])
    constants = {tag: lambda x, k=k: 0 * x[0] + k for tag, k in K.items()}
    k = bodywise(fem.functionspace(mesh, ("DG", 0)), cells, constants)
    form = k * ufl.inner(ufl.grad(ufl.TrialFunction(V)), ufl.grad(ufl.TestFunction(V))) * ufl.dx
    A = petsc.assemble_matrix(fem.form(form))
    A.assemble()
    at = positions(V)[:, up]
    for h, *rounded in BARS:
        q = 200.0 / (0.1 / K[LOWER] + 1 / h + 0.05 / K[UPPER])
        low, high = 200.0 - q * 0.1 / K[LOWER], q * 0.05 / K[UPPER]
        assert [q, low, high] == pytest.approx(rounded, rel=1e-5)
        straight = {
            tag: lambda x, T=T, slope=q / K[tag]: T - slope * x[up]
            for tag, T in ((LOWER, low), (UPPER, high))
        }
        exact = bodywise(V, cells, straight)
        T, through = everywhere(V, exact.x.array), np.zeros(len(at))
        flow = h * s.weight * (jump * T[dofs]).sum(axis=1)
        np.add.at(through, dofs, flow[:, None] * jump)
        left = everywhere(V, (A * exact.x.petsc_vec).array) + COMM.allreduce(through)
        bottom, top = at < -0.1 + 1e-9, at > 0.05 - 1e-9
        whole = q * 0.03**up
        assert largest(left[~bottom & ~top]) < 1e-10 * whole
        assert [left[bottom].sum(), left[top].sum()] == pytest.approx([whole, -whole], rel=1e-10)
        (T_s, g_s), (T_m, g_m) = on_both(s, T)
        for flux in (h * (T_s - T_m), -K[LOWER] * g_s[:, up], -K[UPPER] * g_m[:, up]):
            assert largest(flux / q - 1) < 1e-10


# -- bad input


CALLS = [dm.segments, dm.assemble_mortar]


def given(**changes):
    mesh, _, tags = blocks("triangle", partition="stripes")
    return {"V": scalars(mesh, 1), "facet_tags": tags} | SIDES | changes


@pytest.mark.mpi
@pytest.mark.parametrize("call", CALLS)
def test_spaces_and_displacements_that_do_not_fit(call):
    arguments, (other, _, others) = given(), blocks("triangle")
    mesh, none = arguments["V"].mesh, np.zeros(0, dtype=np.int32)
    cells = dolfinx.mesh.meshtags(mesh, 2, none, none)
    mesh.topology.create_entities(1)
    every = np.arange(mesh.topology.index_map(1).size_local, dtype=np.int32)
    inside = dolfinx.mesh.meshtags(mesh, 1, every, np.full(len(every), TOP_OF_LOWER, np.int32))
    prisms = dolfinx.mesh.create_unit_cube(COMM, 2, 2, 2, dolfinx.mesh.CellType.prism)
    lost, _, of_lost = blocks("triangle")
    lost.geometry.x[:, 0] = np.nan
    for changed, *words in (
        ({"V": fem.functionspace(mesh, ("DG", 1))}, "V has", "scalar or vector Lagrange"),
        ({"V": scalars(mesh, 3)}, "V has", "degree 3", "degree 1 or 2"),
        ({"V": fem.functionspace(mesh, ("Lagrange", 1, (3,)))}, "V has", "shape (3,)"),
        ({"V": space(mesh, 1).sub(0)}, "V is in a part of a larger space", "collapse()"),
        ({"u": fem.Function(space(other, 1))}, "u has to be a Function of V", "mesh of V"),
        ({"u": fem.Function(scalars(mesh, 1))}, "u has the element", "vector Lagrange"),
        ({"u": np.zeros(3)}, "u has to be a Function of V", "array"),
        ({"V": scalars(prisms, 1), "facet_tags": inside}, "prism in 3D are not supported"),
        ({"V": scalars(lost, 1), "facet_tags": of_lost}, "not finite"),
        ({"facet_tags": others}, "slave=3", "another mesh"),
        ({"facet_tags": cells}, "of dimension 2"),
        ({"facet_tags": inside}, "slave=3", "inside the mesh"),
        ({"slave": 9}, "slave=9 marks no facet", "has the values [1, 2, 3, 4, 5, 6]"),
        ({"slave": 2**31}, "slave is 2147483648: "),
        ({"slave": True}, "slave is True: "),
        ({"master": "lid"}, "master is 'lid'", "no names"),
        ({"master": TOP_OF_LOWER}, "slave=3 and master=3 share", "a tag of its own"),
        ({"master": TOP}, "slave=3 and master=2 can never meet", "check the tags"),
    ):
        with rejected(*words):
            call(**(arguments | changed))


@pytest.mark.mpi
def test_what_only_one_of_them_refuses():
    """D and M have the facets of V; the functions of segments may have a lower degree than u."""
    arguments = given()
    u = fem.Function(space(arguments["V"].mesh, 2))
    with rejected("u has degree 2, V degree 1", "give V the degree 2", "interpolate"):
        dm.assemble_mortar(**arguments, u=u)
    assert COMM.allreduce(dm.segments(**arguments, u=u).weight.sum()) == pytest.approx(1.0)
    mesh, _, tags = blocks("triangle", order=2, transform=lambda x: bent(x.T).T)
    with rejected("V", "cells of the mesh are of degree 2", "degree 1"):
        dm.assemble_mortar(scalars(mesh, 1), tags, **SIDES)


@pytest.mark.mpi
@pytest.mark.parametrize("value", [np.nan, -10.0])
def test_displacements_that_turn_a_cell_inside_out(value):
    """Of one node, which one rank owns; not of the interface itself."""
    arguments = given()
    u = fem.Function(space(arguments["V"].mesh, 1))
    x = u.function_space.tabulate_dof_coordinates()
    u.x.array[1::2][np.abs(x - [1.0, 0.5, 0.0]).max(axis=1) < 1e-9] = value
    with (
        np.errstate(invalid="ignore"),
        rejected("1 cells behind master=4", "u turns them inside out", "check mesh and u"),
    ):
        dm.segments(**arguments, u=u)


@pytest.mark.mpi
def test_nodes_with_numbers_of_their_own(monkeypatch):
    """As if no vector space had those of V."""
    arguments = given()
    others = mixed(arguments["V"].mesh, 1).sub(0).collapse()[0]
    monkeypatch.setattr(fem, "functionspace", lambda *_: others)
    with rejected("V numbers its nodes", "dolfinx.fem.functionspace"):
        dm.assemble_mortar(**arguments)
    assert COMM.allreduce(dm.segments(**arguments).weight.sum()) == pytest.approx(1.0)


@pytest.mark.mpi
def test_points_without_a_partner(monkeypatch):
    """Which the kernels mark by NaN, where curved facets are folded, on one rank perhaps."""
    kernel = assembly.find_segments

    def fold(pairing, u):
        points, normals = kernel(pairing, u)
        xi = points.xi_m.copy()
        xi[: COMM.rank == 0] = np.nan
        return dataclasses.replace(points, xi_m=xi), normals

    monkeypatch.setattr(assembly, "find_segments", fold)
    with rejected("1 points of slave=3", "opposite on master=4", "at X + u; check mesh and u"):
        dm.segments(**given())
