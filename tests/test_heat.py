# SPDX-License-Identifier: MIT
"""Conduction across interfaces: bars in series, friction, tools, perfect contact, in time."""

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_mortar as dm
import ufl
from dolfinx import fem
from dolfinx_mortar.heat import Conductance, Heat
from tests.cases import meshes, meshes_3d
from tests.cases.integrals import integral
from tests.cases.meshes import BOTTOM, BOTTOM_OF_UPPER, LOWER, TOP, TOP_OF_LOWER, UPPER
from tests.cases.pressed_blocks import PressedBlocks, rejected

COMM = MPI.COMM_WORLD
K = {LOWER: 50.0, UPPER: 20.0}
SIDES = {"slave": TOP_OF_LOWER, "master": BOTTOM_OF_UPPER}


def bars(cell, comm=COMM, **options):
    if cell in ("triangle", "quadrilateral"):
        sizes = {"heights": (0.1, 0.05), "x_lower": (0.0, 0.03), "x_upper": (0.0, 0.03)}
        return meshes.two_blocks(comm, (3, 2), (5, 2), cell=cell, **sizes, **options)
    box = (0.0, 0.03, 0.0, 0.03)
    sizes = {"heights": (0.1, 0.05), "lower": box, "upper": box}
    return meshes_3d.two_boxes(comm, (2, 2, 1), (3, 3, 1), cell=cell, **sizes, **options)


def ends(V, tags, low=200.0, high=0.0):
    """Return Dirichlet conditions of both ends."""
    dim = V.mesh.topology.dim - 1
    dofs = (fem.locate_dofs_topological(V, dim, tags.find(tag)) for tag in (BOTTOM, TOP))
    return [fem.dirichletbc(v, at, V) for v, at in zip((low, high), dofs, strict=True)]


def largest(values):
    return COMM.allreduce(np.abs(values).max(initial=0.0), MPI.MAX)


# q, T_s, T_m for h: benchmarks of two bars of .1 and .05, k 50 and 20, ends at 200 and 0
BARS = [(100.0, 13793.1, 172.414, 34.483), (1e3, 36363.6, 127.273, 90.909)]
BARS += [(1e4, 43478.3, 113.043, 108.696), (None, 44444.4, 111.111, 111.111)]


@pytest.mark.mpi
@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("cell", ["triangle", "quadrilateral", "tetrahedron", "hexahedron"])
def test_two_bars_in_series(cell, degree):
    """T is linear in both, exactly, for any conductance, also a perfect one."""
    mesh, cells, tags = bars(cell, partition="stripes")
    V = fem.functionspace(mesh, ("Lagrange", degree))
    T = fem.Function(V)
    x = V.tabulate_dof_coordinates()[:, mesh.topology.dim - 1]
    lower = cells_of(V, cells, LOWER)
    for h, *rounded in BARS:
        one = Conductance(dm.Tie(tags, **SIDES), h)
        heat = Heat(T, K, cells, interfaces=[one], bcs=ends(V, tags))
        heat.solve()
        q = 200.0 / (0.1 / 50.0 + (0.0 if h is None else 1.0 / h) + 0.05 / 20.0)
        at_sides = 200.0 - q * 0.002, q * 0.0025
        assert [q, *at_sides] == pytest.approx(rounded, rel=1e-5)
        exact = np.where(lower, 200.0 - q / 50.0 * (x + 0.1), q / 20.0 * (0.05 - x))
        assert largest(T.x.array - exact) < 200e-10
        assert heat.solve() < 1e-10


def cells_of(V, cells, tag):
    """Return the mask of the dofs in cells of a tag."""
    found = np.zeros(len(V.tabulate_dof_coordinates()), dtype=bool)
    found[V.dofmap.list[cells.find(tag)].ravel()] = True
    return found


def held(V, tags, tag, value):
    return fem.dirichletbc(value, fem.locate_dofs_topological(V, 1, tags.find(tag)), V)


@pytest.mark.mpi
def test_bars_that_close_a_gap_by_heat():
    """Problem VM23 of Ansys' verification manual: temperature of the shorter bar, and heat."""
    sizes = {"heights": (0.4, 0.5), "x_lower": (0.0, 0.1), "x_upper": (0.0, 0.1), "gap": 0.0035}
    mesh, _, tags = meshes.two_blocks(COMM, (2, 4), (3, 5), cell="quadrilateral", **sizes)
    V, W = (fem.functionspace(mesh, ("Lagrange", 1, shape)) for shape in ((), (2,)))
    T, zero = fem.Function(V), fem.Constant(mesh, (0.0, 0.0))
    T.x.array[:] = 100.0
    law = {"kinematics": "plane_stress", "eigenstrain": 12e-6 * (T - 100.0)}
    solid = dm.Solid(fem.Function(W), dm.Elastic(10e6, 0.0), **law)
    contact = dm.Contact(tags, **SIDES)
    problem = dm.ContactProblem(
        solid, [contact], bcs=[held(W, tags, s, zero) for s in (BOTTOM, TOP)]
    )
    end = fem.Constant(mesh, 600.0)
    bcs = [held(V, tags, BOTTOM, 500.0), held(V, tags, TOP, end)]
    heat = dm.Heat(T, 250.0, interfaces=[dm.Conductance(contact, 2000.0)], bcs=bcs)
    ramp = {end: [(0.0, 600.0), (1.0, 600.0), (2.0, 850.0), (3.0, 100.0)]}
    side = fem.locate_dofs_topological(V, 1, tags.find(TOP_OF_LOWER))
    expected = [(539.02, 2439.02), (636.59, 8536.59), (500.0, 0.0)]
    for step in dm.load_steps(problem, [1.0, 2.0, 3.0], ramp=ramp, heat=heat):
        temperature, flux = expected[step.number - 1]
        assert largest(T.x.array[side] - temperature) < 0.005
        ds = ufl.Measure("ds", mesh, subdomain_data=tags)(TOP)
        through = 250.0 * ufl.dot(ufl.grad(T), ufl.FacetNormal(mesh)) * ds
        assert integral(through) == pytest.approx(flux, abs=0.005)
        assert (contact.force[1] < 0.0) == (flux > 0.0)


@pytest.mark.mpi
@pytest.mark.parametrize(("degree", "share"), [(1, 0.5), (2, 0.0)])
def test_sliding_slabs(degree, share):
    """A power of mu p v = 3e5 heats two slabs of .02 whose backs are at 0 to 85.714 degrees."""
    sizes = {"heights": (0.02, 0.02), "x_lower": (0.0, 0.06), "x_upper": (0.0, 0.06)}
    mesh, cells, tags = meshes.two_blocks(COMM, (6, 2), (4, 2), cell="quadrilateral", **sizes)
    V, W = (fem.functionspace(mesh, ("Lagrange", degree, shape)) for shape in ((), (2,)))
    E, depth, slip = 4e13, 1e-6, 1.5e-3
    solid = dm.Solid(fem.Function(W), dm.Elastic(E, 0.0))
    contact = dm.Contact(tags, slave=BOTTOM_OF_UPPER, master=TOP_OF_LOWER, friction=0.2)
    zero, slide = (fem.Constant(mesh, 0.0) for _ in range(2))
    of_slabs = [fem.locate_dofs_topological(W.sub(0), 2, cells.find(n)) for n in (LOWER, UPPER)]
    backs = [fem.locate_dofs_topological(W.sub(1), 1, tags.find(n)) for n in (BOTTOM, TOP)]
    bcs = [
        fem.dirichletbc(value, dofs, W.sub(i))
        for i, values, every in ((0, (zero, slide), of_slabs), (1, (0.0, -depth), backs))
        for value, dofs in zip(values, every, strict=True)
    ]
    problem = dm.ContactProblem(solid, [contact], bcs=bcs, geometry="reference")
    T = fem.Function(V)
    ends = [held(V, tags, side, 0.0) for side in (BOTTOM, TOP)]
    heat = dm.Heat(T, K, cells, interfaces=[dm.Conductance(contact, None, share=share)], bcs=ends)
    ramp = {slide: [(0.0, 0.0), (2.0, 2 * slip)]}
    before = 0.0
    for _ in dm.load_steps(problem, [1.0, 2.0], ramp=ramp, heat=heat):
        power, before = contact.dissipation - before, contact.dissipation
        assert power == pytest.approx(0.2 * E * depth / 0.04 * slip * 0.06, rel=1e-6)
        slabs = 0.06 * (50.0 + 20.0) / 0.02
        assert power / slabs == pytest.approx(85.714, abs=5e-4)
        x = V.tabulate_dof_coordinates()[:, 1]
        assert largest(T.x.array - power / slabs * (1.0 - np.abs(x) / 0.02)) < 1e-8


@pytest.mark.mpi
def test_a_closed_contact_warms_up():
    """A test of MOOSE, whose contact is a penalty: T of the side of steel, in five steps."""
    sizes = {"x_lower": (0.0, 0.5), "x_upper": (0.0, 0.5)}
    mesh, cells, tags = meshes.two_blocks(COMM, (10, 40), (10, 40), cell="quadrilateral", **sizes)
    V, W = (fem.functionspace(mesh, ("Lagrange", 1, shape)) for shape in ((), (2,)))
    T, move = fem.Function(V), fem.Constant(mesh, 0.0)
    T.x.array[:] = 300.0
    laws = {LOWER: dm.Elastic(193e9, 0.29), UPPER: dm.Elastic(68e9, 0.36)}
    thermal = {LOWER: 17.3e-6 * (T - 300.0), UPPER: 24e-6 * (T - 300.0)}
    solid = dm.Solid(fem.Function(W), laws, cells, eigenstrain=thermal)
    contact = dm.Contact(tags, **SIDES)
    x, y = (W.sub(i) for i in (0, 1))
    flank = fem.locate_dofs_geometrical((x, x.collapse()[0]), lambda at: np.isclose(at[0], 0.0))[0]
    bcs = [fem.dirichletbc(0.0, flank, x), held(y, tags, BOTTOM, move), held(y, tags, TOP, 0.0)]
    problem = dm.ContactProblem(solid, [contact], bcs=bcs)
    heat = dm.Heat(
        T,
        {LOWER: 16.2, UPPER: 210.0},
        cells,
        capacity={LOWER: 4e3, UPPER: 2430.0},
        interfaces=[dm.Conductance(contact, None)],
        bcs=[held(V, tags, BOTTOM, 300.0), held(V, tags, TOP, 800.0)],
    )
    ramp = {move: [(0.0, 0.0), (10.0, 2e-6)]}
    side = fem.locate_dofs_topological(V, 1, tags.find(TOP_OF_LOWER))
    expected = iter([366.22, 445.38, 511.73, 562.28, 600.11])
    for _ in dm.load_steps(problem, [2.0, 4.0, 6.0, 8.0, 10.0], ramp=ramp, heat=heat):
        assert largest(T.x.array[side] / next(expected) - 1.0) < 7e-4


@pytest.mark.mpi
def test_a_tool_takes_heat():
    """A slab on a plate at 20 degrees: q = (200 - 20) / (L/k + 1/h), with h = 3 p^.95."""
    b = PressedBlocks(cell="quadrilateral", gap=0.5)
    plate = dm.Obstacle(
        b.facets, slave=BOTTOM_OF_UPPER, shape=dm.shapes.Plane((0.0, 0.5), (0.0, 1.0))
    )
    rollers = [b.roller(TOP, 1, -0.01), b.roller(TOP, 0), b.bc(BOTTOM)]
    problem = b.problem([plate], bcs=rollers, law=dm.Elastic(1000.0, 0.0))
    V = fem.functionspace(b.mesh, ("Lagrange", 1))
    T = fem.Function(V)
    joint = dm.Conductance(plate, lambda p, g: 3.0 * p**0.95, temperature=20.0)
    bcs = [held(V, b.facets, TOP, 200.0), held(V, b.facets, BOTTOM, 0.0)]
    heat = dm.Heat(T, 40.0, interfaces=[joint], bcs=bcs)
    (_,) = dm.load_steps(problem, [1.0], heat=heat)
    q = 180.0 / (1.0 / 40.0 + 1.0 / (3.0 * 10.0**0.95))
    side = fem.locate_dofs_topological(V, 1, b.facets.find(BOTTOM_OF_UPPER))
    assert largest(T.x.array[side] - (200.0 - q / 40.0)) < 1e-6


@pytest.mark.mpi
@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"conductivity": -1.0}, ("conductivity is -1.0",)),
        ({"conductivity": {LOWER: 1.0}}, ("conductivity has no entry", "2")),
        ({"capacity": np.nan}, ("capacity is nan",)),
        ({"h": -2.0}, ("h is -2.0",)),
        ({"h": lambda p, g: p - 1.0}, ("Tie(", "is -1 at (", "not negative")),
        ({"share": 1.5}, ("share is 1.5",)),
        ({"bcs": ()}, ("nothing holds the temperature",)),
        ({"interfaces": ["tie"]}, ("interfaces[0] is 'tie'", "Conductance")),
    ],
)
def test_bad_input(changes, words):
    mesh, cells, tags = bars("triangle", partition="stripes")
    V = fem.functionspace(mesh, ("Lagrange", 1))
    given = {"conductivity": K, "cell_tags": cells, "bcs": ends(V, tags)} | changes
    joint = {name: given.pop(name) for name in ("h", "share") if name in given}
    with rejected(*words):
        given.setdefault(
            "interfaces", [dm.Conductance(dm.Tie(tags, **SIDES), **{"h": 1.0} | joint)]
        )
        dm.Heat(fem.Function(V), **given).solve()
