# SPDX-License-Identifier: MIT
"""The exact tangent of contact with a rigid tool: its derivatives, and Newton's rate."""

from dataclasses import replace

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_mortar as dm
from dolfinx import fem, mesh
from dolfinx_mortar.mortar import curvature_correction
from dolfinx_mortar.steps import newton as newton_module
from tests.choice import quick
from tests.tool_case import ELASTIC, SIDE, TOP, Block
from tests.triangles_case import ball

SELF = MPI.COMM_SELF
pytestmark = pytest.mark.serial


class InSpace:
    """A box with uneven cells below z = 0, whose top meets a tool."""

    def __init__(self, cell, degree):
        """Create mesh, tags and space."""
        kind = getattr(mesh.CellType, cell)
        self.mesh = mesh.create_box(SELF, [[-1.0, -1.0, -1.0], [1.0, 1.0, 0.0]], [3, 2, 1], kind)
        top = mesh.locate_entities_boundary(self.mesh, 2, lambda x: np.isclose(x[2], 0.0))
        self.facets = mesh.meshtags(self.mesh, 2, np.sort(top), np.full(len(top), TOP, np.int32))
        x = self.mesh.geometry.x
        x[:, 0] += 0.1 * x[:, 1] + 0.05 * x[:, 0] ** 2
        x[:, 2] -= 0.05 * x[:, 0] * x[:, 1]
        self.V = fem.functionspace(self.mesh, ("Lagrange", degree, (3,)))
        self.u = fem.Function(self.V)

    def tool(self, shape, **options):
        """Return an obstacle for the top."""
        return dm.Obstacle(self.facets, slave=TOP, shape=shape, **options)

    def problem(self, interfaces, law=ELASTIC, **options):
        """Return the problem, with one side of the top held, and one on rollers."""
        at = fem.locate_dofs_geometrical(self.V, lambda x: x[0] > 0.8)
        Q, _ = self.V.sub(1).collapse()
        rollers = fem.locate_dofs_geometrical((self.V.sub(1), Q), lambda x: x[1] < -0.99)
        bcs = [fem.dirichletbc(np.zeros(3), at, self.V)]
        bcs.append(fem.dirichletbc(fem.Function(Q), rollers, self.V.sub(1)))
        return dm.ContactProblem(dm.Solid(self.u, law), interfaces, bcs=bcs, **options)


PLANAR = dm.shapes.Cylinder([0.3, 0.8], 1.0)
RING = dm.shapes.Torus([0.0, 0.5], 0.7, 0.6)
SOLID = dm.shapes.Torus([0.1, 0.0, 0.7], 0.5, 0.8, [0.1, 0.2, 1.0])
CURVED = dm.shapes.Triangles(ball(1, 2.0, (0.1, 0.2, 2.0)), crease=45.0)


def block(degree, n):
    """Return a block whose corner is held, so that a node of its top has no multiplier."""
    case = Block(n=n, size=1.0, fine=0.7, degree=degree)
    sides = fem.locate_dofs_topological(case.V, 1, case.facets.find(SIDE))
    held = [*case.bcs(), fem.dirichletbc(np.zeros(2), sides, case.V)]
    case.bcs = lambda: held
    return case


CASES = {
    "triangles": lambda: (block(1, 4), PLANAR, {}),
    "triangles2": lambda: (block(2, 3), PLANAR, {}),
    "rings": lambda: (block(1, 4), RING, {"kinematics": "axisymmetric"}),
    "rings2": lambda: (block(2, 3), RING, {"kinematics": "axisymmetric"}),
    "tetrahedra": lambda: (InSpace("tetrahedron", 1), SOLID, {}),
    "tetrahedra2": lambda: (InSpace("tetrahedron", 2), SOLID, {}),
    "hexahedra": lambda: (InSpace("hexahedron", 1), SOLID, {}),
    "curved triangles": lambda: (InSpace("hexahedron", 1), CURVED, {}),
    "smooth triangles": lambda: (block(1, 4), PLANAR, {}),
    "smooth rings": lambda: (block(1, 4), RING, {"kinematics": "axisymmetric"}),
    "smooth hexahedra": lambda: (InSpace("hexahedron", 1), SOLID, {}),
    "hexahedra2": lambda: (InSpace("hexahedron", 2), SOLID, {}),
}


def turned(vectors, old, new):
    """Return vectors across the unit normals `old` turned with them to `new`, without spin."""
    along = (vectors * new).sum(axis=1) / (1.0 + (old * new).sum(axis=1))
    return vectors - along[:, None] * (old + new)


class Differences:
    """Forces, gaps and slips of a tool as functions of u, at given tractions."""

    def __init__(self, name, rng):
        """Start from a random displacement of a case."""
        case, shape, options = CASES[name]()
        surface = "smooth" if "smooth" in name else None
        self.tool = case.tool(shape, friction=0.3, surface=surface)
        self.problem = case.problem([self.tool], **options)
        if not options:
            self.tool.rotation.value[...] = 0.2
        self.problem.u.x.array[:] = 0.03 * rng.standard_normal(self.problem.u.x.array.size)
        held = self.problem.supports.owned.ravel()
        self.problem.owned_u[held] = 0.0
        self.start = self.problem.u.x.array.copy()
        self.link = self.at(0.0, np.zeros_like(self.start))
        n, d = len(self.link.nodes), self.problem.d
        kept = self.link.coupling.kept
        assert kept.any() and not kept.all() and (kept[:, 0] & self.held).any()
        self.multipliers, self.tangential = np.zeros(self.problem.n), np.zeros((self.problem.n, d))
        self.multipliers[self.link.nodes] = rng.uniform(0.5, 1.0, n) * kept[:, 0]
        self.along = rng.standard_normal((n, d - 1)) * self.link.coupling.directions[:, 1:]
        self.tangential[self.link.nodes] = self.tangential_at(self.link.coupling)
        x = self.problem.vector(self.problem.X + 0.01 * rng.standard_normal(self.problem.X.shape))
        self.partners = self.tool.partners(self.link, x, frozen=False)
        self.since = x

    def at(self, h, du):
        """Return the link at a displacement."""
        self.problem.u.x.array[:] = self.start + h * du
        (link,) = self.problem.system.at(self.problem.u).links
        return link

    @property
    def held(self):
        """Nodes (n,) of which something is prescribed."""
        return (self.link.coupling.slot >= 0).any(axis=1)

    def tangents(self, coupling):
        """Return tangents without spin, at nodes that are held those normal to prescribed axes."""
        old = self.link.coupling
        rows = np.swapaxes(old.rows[:, 1:], 0, 1)
        free = np.stack([turned(row, old.normals, coupling.normals) for row in rows], axis=1)
        return np.where(self.held[:, None, None], coupling.rows[:, 1:], free)

    def tangential_at(self, coupling):
        """Return the tangential tractions (n, d) of given components."""
        return np.einsum("nk,nki->ni", self.along, self.tangents(coupling))

    def values(self, h, du):
        """Return forces, weighted gaps and slips in turning frames."""
        link = self.at(h, du)
        coupling, nodes = link.coupling, link.nodes
        traction = self.multipliers[nodes, None] * coupling.normals + self.tangential_at(coupling)
        forces, _ = link.transpose(coupling.weight * traction)
        gaps = coupling.weight[:, 0] * link.gaps(self.problem.positions())
        motion = self.partners.motion(link, self.problem.positions() - self.since)
        slips = np.einsum("nki,ni->nk", self.tangents(coupling), motion)
        return forces.ravel(), gaps, slips * coupling.directions[:, 1:]

    def derivatives(self, du):
        """Return what the derivatives say."""
        link, d = self.at(0.0, du), self.problem.d
        found = self.tool.derivatives(link)
        given = self.problem.u, self.multipliers, self.tangential
        H, G, _ = found.differentiate(link, *given)
        v = self.problem.vector(du[: self.problem.n * d])
        since = self.problem.positions() - self.since
        slips = found.slips(link, self.problem.u, self.partners, since)
        gaps = (G * v).array_r.reshape(-1, d)[link.nodes, 0]
        return (H * v).array_r, gaps, slips.of(v) * link.coupling.directions[:, 1:]


@pytest.mark.parametrize("name", quick(CASES, *CASES.keys() - {"hexahedra2", "rings2"}))
def test_derivatives(name, monkeypatch):
    """Against central differences, to 1e-8 of their size: forces, gaps and slips.

    At given strains of the bodies along normals, see `tool_tangent`.
    """
    held = lambda surface, u: np.linspace(0.9, 1.1, len(surface.nodes))  # noqa: E731
    monkeypatch.setattr(curvature_correction, "thickness_stretches", held)
    rng = np.random.default_rng(3)
    case, h = Differences(name, rng), 1e-5
    du = rng.standard_normal(case.start.size)
    du[case.problem.supports.owned.ravel()] = 0.0
    on = case.link.coupling.kept[:, 0]
    exact = case.derivatives(du)
    ends = [case.values(way * h, du) for way in (2.0, 1.0, -1.0, -2.0)]
    for kind, (far, near, back, further) in enumerate(zip(*ends, strict=True)):
        difference = (8.0 * (near - back) - (far - further)) / (12.0 * h)
        found = exact[kind]
        if kind:
            difference, found = difference[on], found[on]
        assert np.abs(found).max() > 0.1
        assert found == pytest.approx(difference, abs=1e-8 * np.abs(found).max()), kind


def tail(monkeypatch, case, tool, exact, **options):
    """Return the excesses of a step's iterations, with or without the exact tangent."""
    problem = case.problem([tool], **options)
    excesses = []
    measure = newton_module.measure

    def recorded(*arguments):
        excesses.append(measure(*arguments))
        return excesses[-1]

    monkeypatch.setattr(newton_module, "measure", recorded)
    allowed = property(lambda self: exact)
    monkeypatch.setattr(newton_module._Step, "may_be_exact", allowed)
    down = np.zeros(len(tool.reference))
    down[-1] = -1.5
    ramp = {tool.position: [(0.0, tool.reference), (1.0, tool.reference + down)]}
    steps = dm.load_steps(problem, [0.5, 1.0], ramp=ramp, rtol=1e-10, progress=False)
    reports = [step.report for step in steps]
    return sum(r.newton_iterations for r in reports), reports[-1], [e.forces for e in excesses]


@pytest.mark.parametrize("friction", [None, pytest.param(0.3, marks=pytest.mark.slow)])
def test_newton_is_quadratic(friction, monkeypatch):
    """A small disc pressed deep into rubber: each exact iteration squares the residual."""
    counts = []
    for exact in (True, False):
        case = Block(n=16, fine=4.0)
        tool = case.tool(dm.shapes.Cylinder([0.0, 2.0], 2.0), friction=friction)
        options = {"law": dm.NeoHooke(1.0, 0.3), "strain": "finite"}
        count, report, forces = tail(monkeypatch, case, tool, exact, **options)
        counts.append(count)
        if exact:
            assert any(iteration.exact_tangent for iteration in report.iterations)
            r = np.array(forces[-4:])  # 0.7 to 1.2 times the square, down to a tenth of rtol
            assert (r[1:] < np.maximum(2.0 * r[:-1] ** 2, 1e-11)).all()
    assert counts[0] < counts[1]


@pytest.mark.slow
def test_without_curvature_it_is_not(monkeypatch):
    """Hess phi belongs to it: without it the iterations are as many as with frozen normals."""
    shape = dm.shapes.Cylinder([0.0, 2.0], 2.0)
    options = {"law": dm.NeoHooke(1.0, 0.3), "strain": "finite"}
    case = Block(n=16, fine=4.0)
    whole = tail(monkeypatch, case, case.tool(shape), True, **options)[0]
    distance = shape.distance

    def flat(x):
        found = distance(x)
        return replace(found, hessian=0.0 * found.hessian)

    monkeypatch.setattr(shape, "distance", flat)
    case = Block(n=16, fine=4.0)
    assert tail(monkeypatch, case, case.tool(shape), True, **options)[0] > whole
