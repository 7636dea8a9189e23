# SPDX-License-Identifier: MIT
"""Slave sides that end on supports at an angle: patch tests under hydrostatic pressure.

Two blocks with an inclined interface, of which the slave ends on rollers, under the pressure P all
around. The stress is -P I, u = -c (X - X0) with X0 on the interface, the pressure of the interface
P everywhere, its force normal to it, and nothing is left to the supports.
"""

import numpy as np
import pytest

import dolfinx_mortar as dm
import ufl
from dolfinx import fem
from tests.cases.meshes import BOTTOM, BOTTOM_OF_UPPER, LEFT, LOWER, RIGHT, TOP, TOP_OF_LOWER, UPPER
from tests.cases.meshes_3d import BACK, FRONT
from tests.cases.pressed_blocks import failing
from tests.cases.rings import largest
from tests.cases.two_bodies import TwoBodies, create_problem
from tests.choice import crosswise

E, NU, P = 1000.0, 0.3, 2.0
EXACT = 1e-9


def facets_of(case, tag, body):
    """Return the facets of a tag on one body."""
    d = case.mesh.topology.dim
    case.mesh.topology.create_connectivity(d - 1, d)
    link, found = case.mesh.topology.connectivity(d - 1, d), case.tags.find(tag)
    return found[np.isin(link.array[link.offsets[found]], case.cells.find(body))]


class Hydrostatic:
    """Two blocks between z = -2 and 2, or rings, whose interface has a slope."""

    def __init__(self, slope, slave="upper", degree=1, cell=None, both=False, inside=None):
        """Create mesh, tags, space, supports and loads."""
        self.slope = np.atleast_1d(slope)
        self.d = d = 1 + len(self.slope)
        self.ring = inside is not None
        middle = np.full(d - 1, 0.5)
        middle[0] += inside or 0.0

        def inclined(x):
            rise = (x[:, :-1] - middle) @ self.slope * (1 - np.abs(x[:, -1]) / 2)
            return np.column_stack([x[:, :-1], x[:, -1] + rise])

        options = {"heights": (2.0, 2.0), "transform": inclined}
        if d == 2:
            ends = (inside or 0.0) + np.array([0.0, 1.0])
            options |= {"n_lower": (3, 3), "n_upper": (4, 3), "x_lower": ends, "x_upper": ends}
        else:
            options |= {"n_lower": (2, 2, 2), "n_upper": (3, 2, 2)}
        cell = cell or ("triangle" if d == 2 else "hexahedron")
        case = TwoBodies(cell, degree, **options)
        self.mesh, self.cells, self.tags = case.mesh, case.cells, case.tags
        self.V, self.u = case.V, case.u
        free = (LEFT, RIGHT, BOTTOM, TOP, FRONT, BACK)[: 2 * d]
        self.side = BOTTOM_OF_UPPER if slave == "upper" else TOP_OF_LOWER
        self.facing = BOTTOM_OF_UPPER + TOP_OF_LOWER - self.side
        self.exact = fem.Function(self.V)
        self.c = P / E * (1 - 2 * NU) * (1.0 if d == 3 or self.ring else 1 + NU)
        at = middle - 0.2
        at[0] = 0.0 if self.ring else at[0]
        self.X0 = np.append(at, (at - middle) @ self.slope)
        sign, rise = (1.0 if slave == "upper" else -1.0), np.append(-self.slope, 1.0)
        self.normal = sign * rise / np.linalg.norm(rise)  # into the slave
        around = 2 * np.pi * middle[0] if self.ring else 1.0
        self.force = P * around * np.linalg.norm(rise) * self.normal  # on the slave
        self.exact.interpolate(lambda x: -self.c * (x[:d] - self.X0[:, None]))
        self.free, self.slaves = free, UPPER if slave == "upper" else LOWER
        masters = LOWER + UPPER - self.slaves
        self.bcs = [self.hold(k, tag, self.slaves) for k, tag in enumerate((LEFT, FRONT)[: d - 1])]
        if both:
            self.bcs += [self.hold(k, tag, masters) for k, tag in enumerate((LEFT, FRONT)[: d - 1])]
        far = fem.locate_dofs_topological(
            self.V, d - 1, facets_of(self, BOTTOM if slave == "upper" else TOP, masters)
        )
        self.bcs.append(fem.dirichletbc(self.exact, far))

    def hold(self, k, tag, body):
        """Prescribe a component of the exact displacement on a side of a body."""
        Q, _ = self.V.sub(k).collapse()
        value = fem.Function(Q)
        value.interpolate(lambda x: -self.c * (x[k] - self.X0[k]))
        spaces, facets = (self.V.sub(k), Q), facets_of(self, tag, body)
        dofs = fem.locate_dofs_topological(spaces, self.mesh.topology.dim - 1, facets)
        return fem.dirichletbc(value, dofs, self.V.sub(k))

    def interface(self, kind, **options):
        """Return the interface: a contact, a tie, or a tool in place of the master."""
        if kind is not dm.Obstacle:
            return kind(self.tags, slave=self.side, master=self.facing, **options)
        shape = dm.shapes.Plane(self.X0, self.normal)
        if self.ring:
            angle = 90 - np.degrees(np.arctan(np.abs(self.slope[0])))
            shape = dm.shapes.Cone(self.X0, angle, [0.0, -np.sign(self.normal[1])])
        return kind(self.tags, slave=self.side, shape=shape, **options)

    def problem(self, interface, **options):
        """Return the problem with the pressure on all but the interface."""
        n, v = ufl.FacetNormal(self.mesh), ufl.TestFunction(self.V)
        ds = ufl.Measure("ds", self.mesh, subdomain_data=self.tags)
        loaded = self.free
        if isinstance(interface, dm.Obstacle):
            loaded = (*loaded, self.facing)
        own = {"kinematics": "axisymmetric"} if self.ring else {}
        own |= {"loads": -P * ufl.inner(n, v) * ds(loaded)}
        return create_problem(self.u, [interface], self.bcs, dm.Elastic(E, NU), **own, **options)


def deg(*degrees):
    return np.tan(np.radians(degrees))


CONTACT, TIE, TOOL = dm.Contact, dm.Tie, dm.Obstacle
ROUGH = {"friction": 0.4}
CASES = {
    "contact, quadrilaterals 2": (CONTACT, {}, {"slope": deg(-60), "cell": "quadrilateral"}),
    "friction 2": (CONTACT, ROUGH, {"slope": deg(45), "degree": 2}),
    "both": (CONTACT, ROUGH, {"slope": deg(10), "both": True}),
    "given friction": (CONTACT, {"tresca": 1.0}, {"slope": deg(30), "slave": "lower"}),
    "rings, friction 2": (CONTACT, ROUGH, {"slope": deg(-40), "inside": 0.7, "degree": 2}),
    "cone": (CONTACT, {}, {"slope": deg(30), "inside": 0.0, "slave": "lower", "both": True}),
    "space": (CONTACT, {}, {"slope": deg(20, -30)}),
    "space, tetrahedra 2": (
        CONTACT,
        ROUGH,
        {"slope": deg(30, 0), "cell": "tetrahedron", "degree": 2},
    ),
    "space, hexahedra 2": (CONTACT, {}, {"slope": deg(15, 20), "degree": 2, "both": True}),
    "tie 2": (TIE, {}, {"slope": deg(-60), "degree": 2, "slave": "lower"}),
    "tie in space": (TIE, {}, {"slope": deg(30, 20), "both": True}),
    "tool, degree 2": (TOOL, {}, {"slope": deg(-60), "degree": 2, "slave": "lower"}),
    "contact 2, 1 degree": (CONTACT, {}, {"slope": deg(-1), "degree": 2, "both": True}),
    "tool, rings": (TOOL, {}, {"slope": deg(-20), "inside": 0.7}),
    "tool in space": (TOOL, {}, {"slope": deg(30, -20)}),
}


@pytest.mark.mpi
@pytest.mark.parametrize(("name", "geometry"), crosswise([*CASES], ["updated", "reference"]))
def test_uniform_pressure(name, geometry):
    """The exact solution, forces of the interface in balance, and none of the supports."""
    kind, given, options = CASES[name]
    case = Hydrostatic(**options)
    interface = case.interface(kind, **given)
    problem = case.problem(interface, geometry=geometry)
    report = dm.newton(problem, rtol=1e-11)
    assert largest(case.u.x.array - case.exact.x.array) < EXACT * largest(case.exact.x.array)
    size = np.linalg.norm(case.force)
    assert np.abs(interface.force - case.force).max() < EXACT * size
    assert np.abs(interface.force + interface.master_force).max() < 1e-14 * size
    assert np.abs(dm.reaction(problem).force).max() < EXACT * size
    assert report.certificate.force_balance < 1e-14
    strained = geometry == "updated" and kind is not TIE  # per area at X + u
    area = (1 - case.c) ** (1 if case.d == 2 and not case.ring else 2) if strained else 1.0
    pressure = interface.gather(case.u)["pressure"]
    assert np.abs(pressure * area - P).max() < EXACT * P


PAST = {
    "contact": (CONTACT, {"slope": deg(-30), "cell": "quadrilateral"}),
    "contact 2": (CONTACT, {"slope": deg(-20), "slave": "lower", "degree": 2}),
    "space": (CONTACT, {"slope": deg(10, 20)}),
    "tool": (TOOL, {"slope": deg(30)}),
    "tool in space": (TOOL, {"slope": deg(-20, 0)}),
}


@pytest.mark.mpi
@pytest.mark.parametrize("name", PAST)
def test_sliding_past(name):
    """A body or a tool slides along a slave on rollers: T = mu N, and all forces are in balance."""
    kind, options = PAST[name]
    case, mu = Hydrostatic(**options), 0.2
    interface = case.interface(kind, friction=mu)
    n, t = case.normal, np.zeros(case.d)
    t[0], t[-1] = case.normal[-1], -case.normal[0]
    if kind is not TOOL:
        shift = fem.Function(case.V)
        shift.interpolate(lambda x: 0.3 * np.tile(t[:, None], x.shape[1]))
        case.exact.x.array[:] += shift.x.array
    problem = case.problem(interface, geometry="reference")
    if kind is TOOL:
        interface.position.value[:] += 0.3 * t
    report = dm.newton(problem, rtol=1e-10)
    F = interface.force
    N, T = F @ n, F - (F @ n) * n
    assert np.linalg.norm(T) == pytest.approx(mu * N, rel=1e-9 if case.d == 2 else 1e-4)
    other = interface.tool_force if kind is TOOL else interface.master_force
    assert np.abs(F + other).max() < 1e-14 * np.linalg.norm(F)
    held = sum(dm.reaction(problem, bc).force for bc in case.bcs[: case.d - 1])
    assert np.abs(held + F - case.force).max() < 1e-8 * np.linalg.norm(F)
    assert report.certificate.force_balance < 1e-14
    found = interface.gather(case.u)
    on_rollers = np.isclose(found["X"][:, 0], 0.0)
    assert (found["status"][on_rollers] == 2).all()


def test_a_body_that_is_wedged_fast():
    """Driven against its rollers by a slope of 60 degrees with mu tan 60 > 1: nothing slides."""
    case = Hydrostatic(deg(60), cell="quadrilateral")
    t = np.array([case.normal[1], -case.normal[0]])
    problem = case.problem(case.interface(CONTACT, friction=0.6), geometry="reference")
    dm.newton(problem)
    problem.commit()
    case.exact.x.array[:] -= 0.3 * np.tile(t, len(case.exact.x.array) // 2)
    with failing(problem, "wedges a body fast"):
        dm.newton(problem)
