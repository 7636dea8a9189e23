# SPDX-License-Identifier: MIT
"""Archard's wear: closed forms, volumes, own slips, limits of explicit steps, state, bad input."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest

import dolfinx_mortar as dm
import ufl
from dolfinx import fem
from dolfinx.mesh import create_unit_square
from dolfinx_mortar.interfaces.wear import Archard
from dolfinx_mortar.qp import solve
from tests.cases.meshes import BOTTOM, LEFT, TOP
from tests.cases.pressed_blocks import rejected
from tests.cases.two_bodies import COMM, TwoBodies, held
from tests.programs import from_arrays, gathered
from tests.test_offset import scalar
from tests.tool_case import Block

pytestmark = pytest.mark.mpi
M = 1000.0 * 0.7 / (1.3 * 0.4)  # confined modulus of the blocks
D = 0.01  # how far their top goes down
H = 2.0  # their height


def least(A, b, upper, give):
    """Return x and z of the QP with yielding bounds, by all active sets."""
    for active in product([False, True], repeat=len(b)):
        on = np.array(active)
        hard, soft = on & (give == 0.0), on & (give > 0.0)
        K, r = A.copy(), b.copy()
        K[soft, soft] += 1.0 / give[soft]
        r[soft] += upper[soft] / give[soft]
        K[hard], r[hard] = np.eye(len(b))[hard], upper[hard]
        x = np.linalg.solve(K, r)
        z = b - A @ x
        if (z[on] >= -1e-9).all() and (x - give * z <= upper + 1e-9 * (1.0 + give)).all():
            return x, z
    raise AssertionError


@pytest.mark.parametrize("seed", range(5))
def test_bounds_that_yield(seed):
    """Compliances over seven orders, some of them zero, against all active sets."""
    rng, n = np.random.default_rng(seed), 6
    root, b = rng.standard_normal((n, n)), 3.0 * rng.standard_normal(n)
    A, upper = root @ root.T + 0.1 * np.eye(n), rng.uniform(-0.5, 0.5, n)
    give = 10.0 ** rng.uniform(-3, 4, n) * (rng.random(n) < 0.8)
    x, z = least(A, b, upper, give)
    qp = from_arrays(A, b, np.full(n, -np.inf), upper, COMM)
    qp = replace(qp, give=give[qp.A.getOwnershipRange()[0] + qp.bounded])
    found = solve(qp, rtol=1e-10)
    assert np.abs(gathered(found.x) - x).max() < 1e-8 * np.abs(x).max()
    assert np.abs(gathered(found.z) - z).max() < 1e-8 * np.abs(z).max()
    with rejected("interior-point", "implicit wear", "active-set"):
        solve(qp, "interior-point")


class Blocks:
    """Blocks on rollers, confined, with a path of sliding out of the plane."""

    def __init__(self, k=1e-3, cell="triangle", degree=1, geometry="updated", law=None, **options):
        self.case = case = TwoBodies(cell, degree)
        self.path = fem.Constant(case.mesh, 0.0)
        given = {"slip": self.path} | options
        self.contact = case.interface(wear=Archard(k, **given), **(law or {}))
        sides = [case.held(LEFT + i, component=i // 2) for i in range(2 * case.d - 2)]
        bcs = [*case.bcs(*(case.d - 1) * [0.0], -D), *sides]
        self.problem = case.problem([self.contact], bcs, geometry=geometry)

    def slide(self, by, **options):
        self.path.value += by
        report = dm.newton(self.problem, rtol=1e-10, **options)
        self.problem.commit()
        return report

    def gather(self, name):
        return self.contact.gather(self.case.u)[name]


@pytest.mark.parametrize("k", [1e-6, 1.0, 1e3])
@pytest.mark.parametrize(
    ("cell", "degree", "geometry"),
    [
        ("triangle", 1, "updated"),
        ("triangle", 2, "reference"),
        ("quadrilateral", 1, "reference"),
        ("tetrahedron", 1, "updated"),
        pytest.param("hexahedron", 1, "updated", marks=pytest.mark.slow),
    ],
)
def test_confined_blocks(cell, degree, geometry, k):
    """With h' = h + k ds p and p = M (d - h') / H: p = M (d - h) / (H + M k ds), for any k ds.

    Depths and gaps to the tolerance of the step, and the round-off of forces times k ds.
    """
    case, h = Blocks(k, cell, degree, geometry), 0.0
    for ds in (0.0, 0.5, 2.0, 10.0):
        case.slide(ds)
        p = M * (D - h) / (H + M * k * ds)
        h += k * ds * p
        limit = 1e-8 * D + 1e-13 * k * ds * M * D
        assert np.abs(case.gather("pressure") - p).max() < 1e-8 * M * D / H
        assert np.abs(case.gather("wear_depth") - h).max() < limit
        assert np.abs(case.gather("gap")).max() < limit


def test_a_body_that_only_the_contact_holds():
    """Under a load p, h = k s p, and the body sinks by the same."""
    case = TwoBodies()
    path, load = fem.Constant(case.mesh, 0.0), fem.Constant(case.mesh, (0.0, -3.0))
    contact = case.interface(wear=Archard(0.01, slip=path))
    v, ds = ufl.TestFunction(case.V), ufl.Measure("ds", case.mesh, subdomain_data=case.facets)
    bcs = [case.held(BOTTOM), *(case.held(LEFT + i, component=0) for i in (0, 1))]
    loads = ufl.inner(load, v) * ds(TOP)
    problem = case.problem([contact], bcs, law=dm.Elastic(1e6, 0.3), loads=loads)
    for path.value in (0.0, 1.0, 11.0):
        dm.newton(problem, rtol=1e-10)
        problem.commit()
        found = contact.gather(case.u)
        assert np.abs(found["pressure"] - 3.0).max() < 1e-7
        assert np.abs(found["wear_depth"] - 0.03 * path.value).max() < 1e-8
    low = COMM.allreduce(case.u.x.array.min(), op=min)
    assert low == pytest.approx(-0.33, abs=1e-5)


R, K, F, E, NU = 10.0, 1e-5, 100.0, 200e3, 0.3


def worn(ball, geometry, paths):
    """Press a cylinder or a ball by F on a hard flat; yield path, results, volumes, and sizes."""
    case = Block(n=48, size=10.0, fine=2.5 if ball else 4.0)
    profile = scalar(case.mesh, 1, lambda x: x[0] ** 2 / (2.0 * R))
    path, force = fem.Constant(case.mesh, 0.0), F if ball else F / 2.0
    flat = dm.shapes.Plane([0.0, 0.0], [0.0, -1.0])
    given = {"load": {"y": -force}, "wear": Archard(K, slip=path), "offset": profile}
    tool = case.tool(flat, **given)
    options = {"kinematics": "axisymmetric"} if ball else {}
    problem = case.problem([tool], dm.Elastic(E, NU), geometry=geometry, **options)
    for s in (0.0, *paths):
        ds, path.value = s - path.value, s
        before = 0.0 if s == 0.0 else tool.wear_depth.x.array.copy()
        dm.newton(problem, rtol=1e-8)
        problem.commit()
        if s > 0.0:
            link, h = problem.system.link(tool), tool.wear_depth.x.array
            local = link.coupling.weight[:, 0] @ (h - before)[link.nodes]
            assert tool.tool_force[1] == pytest.approx(force, rel=1e-7)
            volumes = COMM.allreduce(float(local)), K * tool.tool_force[1] * ds
            a = (4 * R * K * F * s / np.pi) ** 0.25 if ball else (1.5 * R * K * F * s) ** (1 / 3)
            yield s, tool.gather(case.u), volumes, a


@pytest.mark.parametrize("geometry", ["updated", "reference"])
@pytest.mark.parametrize("ball", [False, True])
def test_a_cylinder_and_a_ball(ball, geometry):
    """Rigid limit: V = k F s, a = (3 R k F s / 2)^(1/3) or (4 R k F s / pi)^(1/4), h = a^2 / 2 R.

    The pressure tends to F / 2 a, or F / pi a^2, in a short step at the end. In axisymmetry D has
    the circumference at X, so volumes of moving surfaces agree to the strain.
    """
    sizes = []
    for s, found, (volume, expected), a in worn(ball, geometry, (1.0, 10.0, 100.0, 1e3, 1050.0)):
        exact = 1e-3 if ball and geometry == "updated" else 1e-10
        assert volume == pytest.approx(expected, rel=exact)
        x, h, p = (found[name] for name in ("X", "wear_depth", "pressure"))
        on = h > 0.0
        width = np.sqrt(np.mean(x[on, 0] ** 2 + 2.0 * R * h[on]))  # h = (a^2 - x^2) / 2 R
        if s >= 10.0:  # Hertz' half-width is .076 of .53, his radius .15 of .60
            assert width == pytest.approx(a, rel=2e-3)
            assert h.max() == pytest.approx(a**2 / (2.0 * R), rel=0.012)
            sizes.append(width)
    mean = F / (np.pi * a**2) if ball else F / (2.0 * a)
    assert np.median(p[x[:, 0] < 0.8 * a]) == pytest.approx(mean, rel=0.03)
    known = [0.5973, 1.0623, 1.8890] if ball else [0.5313, 1.1447, 2.4662]
    assert sizes[:3] == pytest.approx(known, rel=2e-3)


@pytest.mark.serial
@pytest.mark.parametrize("strain", ["small", "finite"])
def test_a_disc_on_a_block(strain):
    """Pressed by .05 until the disc is worn by that: sum D_jj dh_j = k ds sum D_jj lambda_j.

    At most six Newton iterations, whatever the length of the step.
    """
    mesh, bodies, sides = dm.meshing.hertz(COMM, kind="graded", h=0.2)
    V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
    law = dm.Elastic(E, NU) if strain == "small" else dm.NeoHooke(E, NU)
    solid, path = dm.Solid(fem.Function(V), law, bodies, strain=strain), fem.Constant(mesh, 0.0)
    contact = dm.Contact(sides, slave="arc", master="top", wear=Archard(K, slip=path))
    bcs = [
        held(V, sides, "bottom"),
        held(V, sides, "flat", -0.05, 1),
        held(V, sides, "flat", 0.0, 0),
    ]
    problem = dm.ContactProblem(solid, [contact], bcs=bcs)
    h = 0.0
    for ds in (0.0, 10.0, 100.0, 1000.0):
        path.value += ds
        report = dm.newton(problem, rtol=1e-9)
        problem.commit()
        link, before, h = problem.system.link(contact), h, contact.wear_depth.x.array.copy()
        weights = link.coupling.weight[:, 0]
        local = weights @ (h - before)[link.nodes], ds * K * (weights @ contact.multiplier)
        volume, expected = COMM.allreduce(np.array(local))
        assert volume == pytest.approx(expected, rel=1e-10) and report.newton_iterations <= 6
    deepest = COMM.allreduce(h.max(), op=max)
    assert deepest == pytest.approx(0.05, rel=1e-3) and abs(contact.force[1]) < 1.0


@pytest.mark.serial
def test_depth_stays_where_it_was_worn():
    """A cylinder presses in one place and then in another: both are worn, by k F s each.

    But for the slope of the contact, a / R = .1, by which forces are not parallel.
    """
    case = Block(n=32, size=10.0, fine=10.0)
    path = fem.Constant(case.mesh, 0.0)
    tool = case.tool(dm.shapes.Cylinder([3.0, R], R), load={"y": -F}, wear=Archard(K, slip=path))
    problem = case.problem([tool], dm.Elastic(E, NU), geometry="reference")
    depths = []
    for x in (3.0, 7.0):
        tool.position.value[0] = x
        for way in (0.0, 100.0):
            path.value += way
            dm.newton(problem, rtol=1e-8)
            problem.commit()
        depths.append(tool.gather(case.u)["wear_depth"])
    at = tool.gather(case.u)["X"][:, 0]
    assert np.array_equal(depths[0][at < 4.5], depths[1][at < 4.5]) and depths[0].max() > 0.05
    assert depths[0][at > 5.5].max() == 0.0 and depths[1][at > 5.5].max() > 0.05
    link = problem.system.link(tool)
    local = link.coupling.weight[:, 0] @ tool.wear_depth.x.array[link.nodes]
    assert COMM.allreduce(float(local)) == pytest.approx(2 * K * F * 100.0, rel=2e-3)


@pytest.mark.parametrize("implicit", [True, False])
def test_own_slips(implicit):
    """Each node has dh = k p |slip|, with the pressure and the slip that the step shows."""
    case = Blocks(1e-3, law={"friction": 0.2}, slip=None, implicit=implicit)
    top, bcs = case.case, case.case.bcs(0.0, -D)
    contact = top.interface(friction=0.2, wear=Archard(1e-3, implicit=implicit))
    problem = top.problem([contact], bcs)
    dm.newton(problem, rtol=1e-10)
    problem.commit()
    before = contact.gather(top.u)["wear_depth"]
    for x in (0.05, -0.1):
        top.top.value[0] = x
        dm.newton(problem, rtol=1e-10)
        problem.commit()
        found = contact.gather(top.u)
        slip = np.linalg.norm(found["step_slip"], axis=1)
        assert slip.max() > 0.03
        dh = 1e-3 * found["pressure"] * slip
        assert np.abs(found["wear_depth"] - before - dh).max() < 1e-7 * dh.max()
        before = found["wear_depth"]


def test_explicit_wear():
    """First p = M (d - h) / H, then h + k ds p; it tends to implicit wear; beyond 2 it fails."""
    case, h = Blocks(1e-4, implicit=False), 0.0
    for ds in (0.0, 1.0, 2.0):
        case.slide(ds)
        p = M * (D - h) / H
        h += 1e-4 * ds * p
        assert np.abs(case.gather("pressure") - p).max() < 1e-9 * M * D
        assert np.abs(case.gather("wear_depth") - h).max() < 1e-10 * D
    before = case.contact.wear_depth.x.array.copy(), case.case.u.x.array.copy()
    with pytest.raises(dm.NewtonNotConverged, match=r"explicit.*above 2.*implicit=True"):
        case.slide(100.0)
    assert np.array_equal(case.contact.wear_depth.x.array, before[0])
    assert np.array_equal(case.case.u.x.array, before[1])
    ends = []
    for implicit, n in product((True, False), (4, 8)):
        case = Blocks(1e-4, implicit=implicit)
        for _ in range(n + 1):
            case.slide(4.0 / n)
        ends.append(case.gather("wear_depth")[0])
    mine, fine, own, other = ends
    assert abs(fine - other) == pytest.approx(0.5 * abs(mine - own), rel=0.1)


@pytest.mark.serial
def test_explicit_steps_below_the_bound_are_steady():
    """At 1.7 of 2: the pressure in the middle falls from step to step (beyond 3 it alternates)."""
    case = Block(n=32, size=10.0, fine=2.0)
    path, profile = fem.Constant(case.mesh, 0.0), scalar(case.mesh, 1, lambda x: x[0] ** 2 / 20.0)
    wear, flat = Archard(1e-5, slip=path, implicit=False), dm.shapes.Plane([0.0, 0.0], [0.0, -1.0])
    tool = case.tool(flat, load={"y": -500.0}, offset=profile, wear=wear)
    problem, peaks = case.problem([tool], dm.Elastic(E, NU), geometry="reference"), []
    for _ in range(25):
        dm.newton(problem, rtol=1e-8)
        problem.commit()
        path.value += 0.03
        peaks.append(tool.gather(case.u)["pressure"][0])
    change = np.diff(peaks)[1:]  # after the first step, without wear
    assert (change < 0.0).all() and change[-1] > 0.1 * change.min()


def test_long_steps_are_cut():
    """`most` bounds the depth of a part; the parts are steps of their own; all of k F s is worn."""
    case = Blocks(1.0, most=0.3 * D)
    table = {case.path: [(0.0, 0.0), (1.0, 0.02)]}
    before = case.case.u.x.array.copy()
    with pytest.raises(dm.NewtonNotConverged, match=r"wears by 0\.00.*most=0\.003"):
        case.slide(0.02)
    assert np.array_equal(case.case.u.x.array, before)
    assert not case.contact.wear_depth.x.array.any()
    case.path.value = 0.0
    (step,) = dm.load_steps(case.problem, [1.0], ramp=table)
    assert len(step.parts) > 1
    assert all(part.converged for part in step.parts)
    assert case.gather("wear_depth").max() > 0.3 * D
    h = case.gather("wear_depth")[0]
    assert np.abs(case.gather("pressure") - M * (D - h) / H).max() < 1e-6 * M * D


def test_a_step_begins_at_the_last_commit():
    """A step that is repeated wears once; looking changes nothing."""
    case = Blocks()
    case.slide(1.0)
    case.path.value += 1.0
    dm.newton(case.problem, rtol=1e-10)
    once = case.gather("wear_depth")
    case.problem.audit()
    case.problem.output_fields()
    dm.newton(case.problem, rtol=1e-10)
    assert np.abs(case.gather("wear_depth") - once).max() < 1e-12 * D
    case.problem.commit()
    case.slide(0.0)
    assert np.abs(case.gather("wear_depth") - once).max() < 1e-12 * D
    shown = case.problem.output_fields()["wear_depth"].x.array.max()
    assert COMM.allreduce(shown, op=max) == pytest.approx(once.max(), rel=1e-12)


def test_a_checkpoint_has_depth_and_path(tmp_path):
    """A run that goes on from a file is the one without a stop; one without wear does not."""
    file = COMM.bcast(tmp_path / "worn.h5")
    case, other = Blocks(), Blocks()
    for ds in (0.0, 1.0):
        case.slide(ds)
    case.problem.save(file)
    other.path.value = case.path.value
    other.problem.restore(file)
    for one in (case, other):
        one.slide(2.0)
    assert np.abs(case.gather("wear_depth") - other.gather("wear_depth")).max() < 1e-10 * D
    plain = TwoBodies()
    with rejected("wear=Archard", "interfaces"):
        plain.problem().restore(file)


WRONG = [
    ({"k": -1.0}, ("wear: k", "-1", ">= 0")),
    ({"k": "soft"}, ("wear: k", "'soft'", "number")),
    ({"slip": 10.0}, ("wear: slip", "10", "Constant", "path")),
    ({"implicit": "yes"}, ("wear: implicit", "'yes'", "True or False")),
    ({"most": 0.0}, ("wear: most", "0", "> 0")),
    ({"slip": None}, ("slip is None", "friction", "slip=")),
]


@pytest.mark.parametrize(("given", "words"), WRONG)
def test_what_is_no_wear(given, words):
    with rejected(*words):
        Blocks(**given)


def test_wear_is_a_law():
    with rejected("wear is 0.1", "Archard"):
        TwoBodies().interface(wear=0.1)
    with rejected("wear: k", "another mesh"):
        Blocks(scalar(create_unit_square(COMM, 2, 2)))
    with rejected("wear_depth", "give wear=", error=AttributeError):
        _ = TwoBodies().interface().wear_depth


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("k", np.nan, ("wear: k", "nan")),
        ("k", -1.0, ("-1", ">= 0")),
        ("path", np.inf, ("slip", "inf")),
    ],
)
def test_values_that_no_wear_has(name, value, words):
    """At the start of a step; nothing has changed, on all ranks."""
    k = fem.Constant(TwoBodies().mesh, 1e-3)
    case = Blocks(k)
    case.slide(1.0)
    before = case.contact.wear_depth.x.array.copy(), case.case.u.x.array.copy()
    (k if name == "k" else case.path).value = value
    with rejected(*words):
        dm.newton(case.problem)
    assert np.array_equal(case.contact.wear_depth.x.array, before[0])
    assert np.array_equal(case.case.u.x.array, before[1])


def test_another_backend():
    """Implicit wear is not for bounds alone."""
    case = Blocks()
    with rejected("interior-point", "implicit wear", "active-set"):
        case.slide(1.0, qp="interior-point")
