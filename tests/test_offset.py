# SPDX-License-Identifier: MIT
"""Offsets of the gap: shims, removed material, profiles; the exact tangent; bad input."""

import numpy as np
import pytest

import dolfinx_mortar as dm
from dolfinx import fem
from dolfinx.mesh import create_unit_square
from tests.cases.differences import accurate
from tests.cases.meshes import LEFT, RIGHT
from tests.cases.pressed_blocks import rejected
from tests.cases.two_bodies import COMM, TwoBodies
from tests.test_tangent import HIDING, PLANAR, RING, SMOOTH, SOLID, created
from tests.tool_case import DEPTH, NU, Block, Box, E, R

pytestmark = pytest.mark.mpi
T = 0.003  # thickness


def scalar(domain, degree=1, f=None):
    """Return a scalar Function of points (n, 3)."""
    found = fem.Function(fem.functionspace(domain, ("Lagrange", degree)))
    if f is not None:
        found.interpolate(f)
    return found


def kinds(domain, value):
    """Return all kinds of a constant offset."""
    same = [scalar(domain, k, lambda x: np.full(x.shape[1], value)) for k in (1, 2)]
    return [value, fem.Constant(domain, value), *same]


def pressed(cell, degree, offset, gap=0.0, geometry="updated"):
    """Press blocks; return the contact, the problem, the reaction of the base and the report.

    On rollers, and clamped with bulging sides for fixed normals.
    """
    case = TwoBodies(cell, degree, gap=gap)
    contact = case.interface(offset=None if offset is None else offset(case.mesh))
    bcs = case.bcs(*(case.d - 1) * [0.0], -0.01)
    if geometry == "updated":
        bcs += [case.held(LEFT + k, component=k // 2) for k in range(2 * case.d - 2)]
    problem = case.problem([contact], bcs, geometry=geometry)
    report = dm.newton(problem, rtol=1e-12)
    return contact, problem, dm.reaction(problem, bcs[0]).force, report


@pytest.mark.parametrize(
    ("cell", "degree"),
    [
        ("triangle", 1),
        ("triangle", 2),
        ("quadrilateral", 1),
        ("tetrahedron", 1),
        pytest.param("hexahedron", 2, marks=pytest.mark.slow),
    ],
)
@pytest.mark.parametrize("geometry", ["updated", "reference"])
def test_a_shim_fills_the_gap(cell, degree, geometry):
    """Blocks that are T apart, with a shim of T, are as blocks that touch, and notes are none."""
    one, here, force, _ = pressed(cell, degree, None, geometry=geometry)
    for k in range(4 if cell == "triangle" else 1):
        shim = lambda domain, k=k: kinds(domain, -T)[k]  # noqa: E731
        other, there, same, report = pressed(cell, degree, shim, gap=T, geometry=geometry)
        assert np.abs(same - force).max() < 1e-10 * np.abs(force).max()
        p, q = (c.gather(at.u)["pressure"] for c, at in ((one, here), (other, there)))
        assert np.abs(p - q).max() < 1e-10 * p.max() and p.min() > 0.0
        assert np.abs(other.gather(there.u)["gap"]).max() < 1e-12
    assert not [note for note in report.notes if "in each other" in note]


@pytest.mark.parametrize("kind", ["contact", "tool"])
def test_removed_material_leaves_no_note(kind):
    """Where T was removed, sides that lie T in each other just touch; the gap says so."""
    depth = 0.2  # more than the tolerance of notes for these facets
    if kind == "contact":
        case = TwoBodies(gap=-depth, x_upper=(0.25, 0.75))
        contact = case.interface(offset=depth)
        problem = case.problem([contact])
    else:
        case = Box("triangle", (3, 2))
        contact = case.tool(dm.shapes.Plane([0.0, 1.0 - depth], [0.0, -1.0]), offset=depth)
        problem = case.problem([contact])
    report = dm.newton(problem)
    assert np.abs(contact.force).max() < 1e-10 and not report.notes
    assert np.nanmax(np.abs(contact.gather(case.u)["gap"])) < 1e-12
    assert contact.offset == depth


def test_the_gap_has_the_offset():
    """At open nodes: the distance of the meshes plus the offset at each node."""
    case = TwoBodies(gap=0.1)
    contact = case.interface(offset=scalar(case.mesh, 1, lambda x: 0.2 * x[0] - 0.05))
    dm.newton(case.problem([contact]))
    found = contact.gather(case.u)
    assert found["gap"] == pytest.approx(0.05 + 0.2 * found["X"][:, 0], abs=1e-12)
    assert not found["pressure"].any()


@pytest.mark.parametrize("unit", [1.0, 1e-3])
@pytest.mark.parametrize("geometry", ["updated", "reference"])
def test_a_growing_shim_presses_bars(unit, geometry):
    """Bars between walls, sides on rollers: p = M t / H, M = E (1 - nu) / (1 + nu) / (1 - 2 nu).

    In metres as in millimetres, and read at every step.
    """
    case = TwoBodies(transform=lambda x: unit * x)
    t = fem.Constant(case.mesh, 0.0)
    contact = case.interface(offset=t)
    sides = [case.held(tag, component=0) for tag in (LEFT, RIGHT)]
    problem = case.problem([contact], [*case.bcs(), *sides], geometry=geometry)
    M = 1000.0 * 0.7 / (1.3 * 0.4)
    table = [(-1.0, unit * T), (1.0, -unit * T)]
    steps = dm.load_steps(problem, [0.5, 1.0, 0.25, -0.5], ramp={t: table})
    for step in steps:
        p = contact.gather(case.u)["pressure"]
        expected = M * T * max(step.time, 0.0) / 2.0
        assert np.abs(p - expected).max() < 1e-9 * M * T
        assert contact.force[1] == pytest.approx(-expected * unit, abs=1e-9 * M * T * unit)


@pytest.mark.parametrize("tool", [False, True])
def test_a_profile_is_a_cylinder(tool):
    """A flat side with the offset x^2 / 2 R below a plane: Hertz' pressure."""
    case = Block(n=60, size=20.0, fine=0.3)
    profile = scalar(case.mesh, 1, lambda x: np.minimum(x[0] ** 2 / (2.0 * R), 1.0))
    shape = dm.shapes.Cylinder([0.0, R], R) if tool else dm.shapes.Plane([0.0, 0.0], [0.0, -1.0])
    contact, _, _ = case.press(case.tool(shape, offset=None if tool else profile), DEPTH)
    found, force = contact.gather(case.u), -2.0 * contact.force[1]  # of both halves
    hertz = dm.analytic.hertz_line(force, R, E, NU, 1e9 * E, NU)
    x, p = found["X"][:, 0], found["pressure"]
    inside = x < 0.9 * hertz.half_width
    assert inside.sum() > 16
    assert np.abs(p - hertz.pressure(x))[inside].max() < 0.02 * hertz.peak_pressure


ROWS = [
    ("triangle", 1, {}),
    ("triangle", 2, SMOOTH),
    ("triangle", 1, HIDING),
    ("triangle", 1, {"part": "itself"}),
    ("tetrahedron", 1, SMOOTH),
    ("hexahedron", 1, {}),
    ("triangle", 1, PLANAR),
    ("triangle", 2, RING),
    ("tetrahedron", 2, SOLID),
]


@pytest.mark.parametrize(("cell", "degree", "options"), ROWS)
def test_the_tangent_is_exact(cell, degree, options, monkeypatch):
    """As without offset: D changes with u, so offsets of weighted gaps do."""
    init = dm.Contact.take

    def take(self, owner, V):
        self.offset = scalar(V.mesh, 1, lambda x: 0.03 + 0.02 * np.sin(5.0 * x[0] + 3.0 * x[1]))
        init(self, owner, V)

    for kind in (dm.Contact, dm.Obstacle):
        monkeypatch.setattr(kind, "take", take)
    with accurate():
        case = created(cell, degree, options)
        assert max(case.errors()) < 1e-9
    assert case.link.coupling.offset is not None


def on_another_mesh(domain):
    return scalar(create_unit_square(COMM, 2, 2))


def function(*element):
    return lambda domain: fem.Function(fem.functionspace(domain, element))


WRONG = [
    (lambda domain: "thin", ("'thin'", "number")),
    (lambda domain: np.inf, ("inf", "number")),
    (lambda domain: True, ("True", "number")),
    (lambda domain: fem.Constant(domain, (0.1, 0.2)), ("scalar",)),
    (function("Lagrange", 1, (2,)), ("shape (2,)", "scalar")),
    (function("DG", 0), ("not one value at every node", "interpolate")),
    (on_another_mesh, ("another mesh", "solid.mesh")),
]


@pytest.mark.parametrize(("make", "words"), WRONG)
@pytest.mark.parametrize("tool", [False, True])
def test_what_is_no_offset(make, words, tool):
    case = TwoBodies()
    with rejected("offset", *words):
        if tool:
            shape = dm.shapes.Plane([0.0, 3.0], [0.0, -1.0])
            contact = dm.Obstacle(case.tags, slave=2, shape=shape, offset=make(case.mesh))
        else:
            contact = case.interface(offset=make(case.mesh))
        case.problem([contact])


@pytest.mark.parametrize(
    ("value", "words"),
    [(np.nan, ("nan", "finite")), (100.0, ("100", "diagonal", "unit of the mesh"))],
)
@pytest.mark.parametrize("kind", [0, 1, 2])
def test_values_that_no_gap_has(value, words, kind):
    """At the start of the step, on all ranks, before anything has moved."""
    case = TwoBodies()
    offset = kinds(case.mesh, -T)[1 + kind]
    contact = case.interface(offset=offset)
    problem = case.problem([contact], case.bcs(0.0, -0.01))
    dm.newton(problem)
    problem.commit()
    before, force = case.u.x.array.copy(), contact.force
    if kind:
        offset.interpolate(lambda x: np.where(x[0] < 0.1, value, 0.0))
    else:
        offset.value = value
    with rejected("offset", *words):
        dm.newton(problem)
    assert np.array_equal(case.u.x.array, before) and np.array_equal(contact.force, force)
