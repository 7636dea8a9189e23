# SPDX-License-Identifier: MIT
"""Conduction across interfaces: bars in series, friction, tools, perfect contact, in time."""

from dataclasses import dataclass

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_mortar as dm
import ufl
from dolfinx import fem
from dolfinx_mortar.heat import Conductance, Heat
from dolfinx_mortar.interfaces.results import NoResult
from tests.cases import meshes, meshes_3d
from tests.cases.integrals import integral
from tests.cases.meshes import BOTTOM, BOTTOM_OF_UPPER, LOWER, TOP, TOP_OF_LOWER, UPPER
from tests.cases.meshes_3d import rotation
from tests.cases.pressed_blocks import PressedBlocks, rejected
from tests.cases.solid import hold, plane, rectangle, rollers, stand, tag_facets

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


@pytest.mark.filterwarnings("ignore:invalid value")
@pytest.mark.mpi
def test_a_prism_warms_a_cube():
    """A transient test of CalculiX, in which .01 x 164.38 crosses .2^2 by a conductance of 3."""
    sizes = {"lower": (0, 1, 0, 1), "upper": (0.4, 0.6, 0.4, 0.6), "heights": (1.0, 0.2)}
    mesh, cells, tags = meshes_3d.two_boxes(COMM, (1,) * 3, (1,) * 3, cell="hexahedron", **sizes)
    x, upper = mesh.geometry.x, np.unique(mesh.geometry.dofmap[cells.find(UPPER)])
    x[upper, :2] = 0.5 + (x[upper, :2] - 0.5) @ rotation([0, 0, 1], np.pi / 4)[:2, :2].T
    V = fem.functionspace(mesh, ("Lagrange", 1))
    T, bcs = fem.Function(V), ends(V, tags, 0.0, 1000.0)
    bcs[1].set(T.x.array)
    joint = Conductance(dm.Tie(tags, slave=BOTTOM_OF_UPPER, master=TOP_OF_LOWER), 3.0)
    heat, found = Heat(T, 0.01, capacity=7.8e-6, interfaces=[joint], bcs=bcs), []
    steps = [1e-4, *(1e-4 * 1.5 ** np.arange(8))]
    for dt in [*steps, 0.006 - sum(steps)]:
        heat.solve(dt)
        heat.commit()
        found.append(T.x.array.copy())
    for k, expected in ((0, (51.45, 66.89)), (-1, (164.38, 178.08))):
        for tag, value in zip((TOP_OF_LOWER, BOTTOM_OF_UPPER), expected, strict=True):
            nodes = fem.locate_dofs_topological(V, 2, tags.find(tag))
            assert largest(found[k][nodes] - value) < 0.005


GROWN = {
    "plane_strain": [0.5, 1.0, 0.0],
    "axisymmetric": [0.5, 1.0, 0.5],
    "spatial": [0.5, 0.5, 1.0],
}


@pytest.mark.mpi
@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("kind", GROWN)
def test_bars_that_have_grown(kind, degree):
    """Twice as long, 1.5 as wide: widths cancel, and radii of rings; a tool at the end."""
    mesh, cells, tags = bars("tetrahedron" if kind == "spatial" else "quadrilateral")
    d, h, ground = mesh.topology.dim, fem.Constant(mesh, 100.0), fem.Constant(mesh, 10.0)
    V, W = (fem.functionspace(mesh, ("Lagrange", n, s)) for n, s in ((degree, ()), (1, (d,))))
    how = {"kinematics": kind, "strain": "finite", "eigenstrain": np.diag(GROWN[kind])}
    solid = dm.Solid(fem.Function(W), dm.NeoHooke(1.0, 0.0), **how)
    end = dm.shapes.Plane([0.0] * (d - 1) + [0.2], [0.0] * (d - 1) + [-1.0])
    tool, tie = dm.Obstacle(tags, slave=TOP, shape=end), dm.Tie(tags, **SIDES)
    bcs = [hold(W, tags.find(BOTTOM), d - 1), *(hold(W, plane(i), i) for i in range(d - 1))]
    dm.newton(dm.ContactProblem(solid, [tie, tool], bcs=bcs), rtol=1e-12)
    T, joints = fem.Function(V), [Conductance(tie, h), Conductance(tool, h, h, temperature=ground)]
    axisymmetric = kind == "axisymmetric"
    bcs = ends(V, tags)[:1]
    heat = Heat(T, K, cells, interfaces=joints, bcs=bcs, u=solid.u, axisymmetric=axisymmetric)
    x, lower = V.tabulate_dof_coordinates()[:, d - 1], cells_of(V, cells, LOWER)
    for h.value, ground.value in ((100.0, 10.0), (300.0, -50.0)):
        heat.solve()
        heat.commit()
        q = (200.0 - ground.value) / (0.2 / 50.0 + 0.1 / 20.0 + 2 / h.value)
        above = ground.value + q / h.value + q / 20.0 * 2 * (0.05 - x)
        exact = np.where(lower, 200.0 - q / 50.0 * 2 * (x + 0.1), above)
        assert largest(T.x.array - exact) < 1e-8


@pytest.mark.mpi
@pytest.mark.parametrize("h", [100.0, None])
def test_a_current_heats_bars_and_their_joint(h):
    """Power j^2 / sigma in both, j^2 / 30 between, of which .3 enters the lower bar."""
    mesh, cells, tags = bars("quadrilateral", partition="stripes")
    V = fem.functionspace(mesh, ("Lagrange", 1))
    tie, (phi, T) = dm.Tie(tags, **SIDES), (fem.Function(V) for _ in range(2))
    (a, b), (k, m), (s, r) = (0.1, 0.05), K.values(), (2.0, 5.0)
    joint = Conductance(tie, 30.0, share=0.3)
    given = {"interfaces": [joint], "bcs": ends(V, tags, 7.0)}
    current = Heat(phi, {LOWER: s, UPPER: r}, cells, **given)
    given = {"interfaces": [Conductance(tie, h)], "bcs": ends(V, tags, 0.0), "current": current}
    heat = Heat(T, K, cells, **given)
    heat.solve()
    j = 7.0 / (a / s + 1 / 30.0 + b / r)
    # T = A (z + a) - j^2 (z + a)^2 / (2 s k) below, B (b - z) - .. above
    low, high = j**2 / s, j**2 / r
    power, drop = j**2 / 30.0, 0.0 if h is None else 1 / h
    across = np.array([0.3 * power + low * a, -0.7 * power - high * b])  # less k A, plus m B
    rows = [[a + k * drop, -b], [k, m]]
    given = [low * a**2 / (2 * k) - high * b**2 / (2 * m) + drop * across[0], across[0] - across[1]]
    A, B = np.linalg.solve(rows, given)
    x = V.tabulate_dof_coordinates()[:, 1]
    below = A * (x + a) - low / (2 * k) * (x + a) ** 2
    above = B * (b - x) - high / (2 * m) * (b - x) ** 2
    assert largest(T.x.array - np.where(cells_of(V, cells, LOWER), below, above)) < 1e-9 * largest(
        T.x.array
    )


@pytest.mark.slow
@pytest.mark.mpi
def test_a_block_that_slides_fast():
    """Wriggers and Miehe (1994), VM229 of Ansys: temperatures at rest, and all heat is friction."""
    sizes = {"heights": (1.25, 1.25), "x_lower": (0.0, 5.0), "x_upper": (0.0, 1.25)}
    mesh, cells, tags = meshes.two_blocks(COMM, (12, 3), (4, 3), cell="quadrilateral", **sizes)
    V, W = (fem.functionspace(mesh, ("Lagrange", 1, shape)) for shape in ((), (2,)))
    T, (slide, load) = fem.Function(V), (fem.Constant(mesh, 0.0) for _ in range(2))
    solid = dm.Solid(fem.Function(W), dm.Elastic(7e4, 0.3), eigenstrain=23.86e-6 * T)
    contact = dm.Contact(tags, slave=BOTTOM_OF_UPPER, master=TOP_OF_LOWER, friction=0.2)
    bcs = [hold(W, tags.find(BOTTOM)), hold(W, tags.find(TOP), 0, slide)]
    ds = ufl.Measure("ds", mesh, subdomain_data=tags)(TOP)
    problem = dm.ContactProblem(
        solid, [contact], bcs=bcs, loads=-load * ufl.TestFunction(W)[1] * ds
    )
    heat = Heat(T, 150.0, capacity=2.43, interfaces=[Conductance(contact, 0.0)], u=solid.u)
    start, end = 1e-6, 3.75e-3
    ramp = {load: [(0.0, 0.0), (start, 10.0), (1.0, 10.0)]}
    ramp[slide] = [(0.0, 0.0), (start, 0.0), (end, 3.75), (1.0, 3.75)]
    times = [start, *np.linspace(0.0, end, 9)[1:], 0.02, 0.1, 0.3, 1.0]
    for _ in dm.load_steps(problem, times, ramp=ramp, heat=heat):
        assert 2.43 * integral(T * ufl.dx) == pytest.approx(contact.dissipation, rel=1e-7)
    for tag, expected in ((UPPER, 1.235), (LOWER, 0.309)):
        assert largest(T.x.array[cells_of(V, cells, tag)] - expected) < 1e-3


def heated_bar(gap):
    """Return bar, tool and heat; it touches the wall, and then loses more heat than it can."""
    domain = rectangle([(0, 0), (1, 4)], (1, 4))
    V, tags = (
        fem.functionspace(domain, ("Lagrange", 1)),
        tag_facets(domain, plane(1, 4.0), plane(1)),
    )
    T, hot = fem.Function(V), fem.Constant(domain, 10.0)
    wall = dm.Obstacle(tags, slave=1, shape=dm.shapes.Plane((0.0, 4.0 + gap), (0.0, -1.0)))
    how = {"eigenstrain": 1e-3 * T, "kinematics": "plane_stress"}
    problem = stand(domain, dm.Elastic(1e3, 0.0), rollers, [wall], **how)
    bcs = [fem.dirichletbc(hot, fem.locate_dofs_topological(V, 1, tags.find(2)), V)]
    return problem, wall, hot, Heat(T, 1.0, interfaces=[Conductance(wall, 1e6)], bcs=bcs)


@pytest.mark.mpi
def test_turns_that_never_agree_are_undone():
    """Hot it closes the gap, cooled by the wall it opens it: no steady state (Barber 1978)."""
    problem, wall, hot, heat = heated_bar(0.3)
    (_,) = dm.load_steps(problem, [1.0], heat=heat)
    assert largest(heat.T.x.array - 10.0) < 1e-12  # without a range
    state = [problem.u, heat.T, problem.solid.stress, *wall.nodal.values()]
    before = [f.x.array.copy() for f in state], wall.force.copy()
    hot.value = 100.0
    with pytest.raises(dm.NewtonNotConverged, match=r"do not agree after 50 .* no steady state"):
        list(dm.load_steps(problem, [2.0], heat=heat))
    assert all(map(np.array_equal, [f.x.array for f in state], before[0]))
    assert np.array_equal(wall.force, before[1]) and problem.committed.level == 1.0
    hot.value = 70.0  # 70 opens, and it is free
    (_,) = dm.load_steps(problem, [2.0], heat=heat)
    assert problem.u.x.array.size == 0 or largest(heat.T.x.array - 70.0) < 1e-9


@pytest.mark.mpi
def test_steps_in_time_with_inertia():
    """A source alone: T = r t / c, and the bar, whose waves are fast, grows with it."""
    domain = rectangle([(0, 0), (1, 4)], (1, 4))
    T = fem.Function(fem.functionspace(domain, ("Lagrange", 1)))
    how = {"eigenstrain": 1e-3 * T, "kinematics": "plane_stress"}
    inertia = [], lambda solid: [dm.Inertia(solid, 1e-9)]
    problem = stand(domain, dm.Elastic(1e3, 0.0), rollers, *inertia, **how)
    heat = Heat(T, 1.0, capacity=2.0, sources=6.0)
    for step in dm.time_steps(problem, [0.5, 1.0, 2.0], heat=heat):
        assert largest(T.x.array - 3.0 * step.time) < 1e-12
        assert largest(problem.u.x.array) == pytest.approx(4.0 * 3e-3 * step.time, rel=1e-6)


def pressed_and_heated(comm):
    """Return force, temperatures and potential of blocks that a current heats, and friction."""
    sizes = {"heights": (0.1, 0.05), "x_lower": (0.0, 0.04), "x_upper": (0.0, 0.03)}
    mesh, cells, tags = meshes.two_blocks(comm, (4, 3), (5, 2), cell="triangle", **sizes)
    V, W = (fem.functionspace(mesh, ("Lagrange", 1, shape)) for shape in ((), (2,)))
    phi, T, down = fem.Function(V), fem.Function(V), fem.Constant(mesh, (1e-4, -1e-5))
    solid = dm.Solid(fem.Function(W), dm.Elastic(1e5, 0.3), eigenstrain=1e-5 * T)
    contact = dm.Contact(tags, **SIDES, friction=0.3)
    bcs = [hold(W, tags.find(BOTTOM)), hold(W, tags.find(TOP), None, down)]
    problem, tops = dm.ContactProblem(solid, [contact], bcs=bcs), {"u": solid.u}
    joint = Conductance(contact, lambda p, g: 10.0 * p**0.9, share=0.2)
    current = Heat(phi, 3.0, interfaces=[joint], bcs=ends(V, tags, 50.0), **tops)
    given = {"capacity": 10.0, "bcs": ends(V, tags, 0.0), "current": current}
    heat = Heat(T, K, cells, interfaces=[joint], **given, **tops)
    (_,) = dm.load_steps(problem, [1.0], heat=heat, rtol=1e-11)
    sums = [fem.assemble_scalar(fem.form(f**2 * ufl.dx)) for f in (T, phi)]
    return np.array([*contact.force, *(comm.allreduce(value) for value in sums)])


@pytest.mark.mpi
def test_ranks_agree():
    found, alone = pressed_and_heated(COMM), pressed_and_heated(MPI.COMM_SELF)
    assert np.abs(alone).min() > 1e-6 and found == pytest.approx(alone, rel=1e-10)


@dataclass(frozen=True)
class Later:
    """A Constant that becomes this number after everything is made."""

    value: float


def elsewhere(tags):
    return dm.Tie(bars("triangle")[2], **SIDES)


def unsolved(tags):
    return dm.Contact(tags, **SIDES)


def of_cells(V):
    return fem.Function(fem.functionspace(V.mesh, ("DG", 0)))


def potential(V):
    return Heat(fem.Function(fem.functionspace(V.mesh, ("Lagrange", 2))), 1.0)


BAD = [
    ({"T": "hot"}, "T is 'hot'"),
    ({"conductivity": -1.0}, "conductivity is -1.0"),
    ({"conductivity": "steel"}, "conductivity is 'steel'"),
    ({"conductivity": Later(np.nan)}, "conductivity is nan"),
    ({"conductivity": {LOWER: 1.0}}, "conductivity has no entry.*2"),
    ({"conductivity": {LOWER: 1.0, UPPER: Later(0.0)}}, r"conductivity\[2\] is 0.0.*> 0"),
    ({"capacity": np.nan}, "capacity is nan"),
    ({"capacity": Later(-1.0)}, "capacity is -1.0"),
    ({"capacity": {UPPER: 1.0}}, "capacity has no entry"),
    ({"h": -2.0}, "h is -2.0"),
    ({"h": np.inf}, "h is inf"),
    ({"h": Later(-2.0)}, r"Tie\(.*is -2 at \(.*not negative"),
    ({"h": Later(np.nan)}, r"Tie\(.*is nan at \(.*finite"),
    ({"h": lambda p, g: p - 1.0}, r"Tie\(.*is -1 at \(.*not negative"),
    ({"h": lambda p, g: np.ones(2)}, r"values of the shape \(2,\) at"),
    ({"h": of_cells}, "values of the shape .* at .* Function of T's space"),
    ({"open": "air"}, "open is 'air'"),
    ({"temperature": np.nan}, "temperature is nan"),
    ({"share": 1.5}, "share is 1.5"),
    ({"bcs": 0}, "nothing holds the temperature"),
    ({"bcs": 1, "h": 0.0}, "nothing holds the temperature"),
    ({"sources": Later(np.inf)}, "sources, loads, conditions or temperatures of tools are not fin"),
    ({"interfaces": ["tie"]}, r"interfaces\[0\] is 'tie'.*Conductance"),
    ({"side": elsewhere}, r"interfaces\[0\]: facet_tags.*of the same mesh"),
    ({"side": unsolved}, r"Contact.* has no active yet"),
    ({"current": potential}, "current is .*on T's space"),
    ({"dt": 0.0}, "dt is 0.0"),
]


@pytest.mark.mpi
@pytest.mark.parametrize(("changes", "words"), BAD)
def test_bad_input(changes, words):
    mesh, cells, tags = bars("triangle", partition="stripes")
    V, late = fem.functionspace(mesh, ("Lagrange", 1)), []

    def made(value):
        if isinstance(value, Later):
            late.append((fem.Constant(mesh, 1.0), value.value))
            return late[-1][0]
        if isinstance(value, dict):
            return {key: made(entry) for key, entry in value.items()}
        return value(V) if value in (of_cells, potential) else value

    given = {
        "T": fem.Function(V),
        "conductivity": K,
        "h": 1.0,
        "side": lambda tags: dm.Tie(tags, **SIDES),
    }
    given |= {name: made(value) for name, value in changes.items()}
    bcs, dt, side = ends(V, tags)[: given.pop("bcs", 2)], given.pop("dt", None), given.pop("side")
    names = [name for name in ("h", "open", "share", "temperature") if name in given]
    joint = {name: given.pop(name) for name in names}
    with pytest.raises((ValueError, NoResult), match=words):
        given.setdefault("interfaces", [Conductance(side(tags), **joint)])
        heat = Heat(given.pop("T"), given.pop("conductivity"), cells, bcs=bcs, **given)
        for constant, value in late:
            heat.solve(1.0)
            constant.value = value
        heat.solve(dt)


@pytest.mark.mpi
def test_an_interface_of_another_problem():
    one, other = PressedBlocks(), PressedBlocks()
    problem, contact = one.problem([one.contact()]), other.contact()
    other.problem([contact])
    heat = Heat(
        fem.Function(fem.functionspace(other.mesh, ("Lagrange", 1))),
        1.0,
        interfaces=[Conductance(contact, 1.0)],
    )
    with rejected("heat: Contact(", "another problem"):
        list(dm.load_steps(problem, [1.0], heat=heat))
