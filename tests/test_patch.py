# SPDX-License-Identifier: MIT
"""Contact patch tests: a constant stress state across a non-matching interface, to round-off."""

import hypothesis
import hypothesis.strategies as st
import numpy as np
import pytest

import dolfinx_mortar as dm
import ufl
from dolfinx import default_scalar_type, fem
from tests.cases.meshes import BOTTOM, LEFT, TOP
from tests.cases.meshes_3d import FRONT, rotation
from tests.cases.mortar import largest
from tests.cases.two_bodies import CELLS, COMM, TwoBodies

E, NU, P = 1000.0, 0.4, 10.0
EXACT = 1e-10


def beyond(mesh, x, cut, lines, degree, weight=np.ones_like):
    """Return a traction share with the weighted moments of the indicator of x > ``cut``."""
    k = int(np.searchsorted(lines, cut)) - 1
    a = b = cut
    share = np.array([1.0, 0.0, 0.0])  # of 1, s and s^2, with s from 0 to 1 along the facet
    if 0 <= k < len(lines) - 1 and not np.isclose(cut, lines[k + 1], rtol=0, atol=1e-14):
        a, b = lines[k], lines[k + 1]
        points, weights = np.polynomial.legendre.leggauss(5)

        def moments(low):
            s = low + (1 - low) / 2 * (1 + points)
            powers = s ** np.arange(degree + 1)[:, None]
            return powers, powers * weights * weight(a + s * (b - a)) * (1 - low) / 2

        (powers, whole), (_, part) = moments(0.0), moments((cut - a) / (b - a))
        share[: degree + 1] = np.linalg.solve(whole @ powers.T, part.sum(axis=1))
    length = b - a if b > a else 1.0
    c = [
        fem.Constant(mesh, default_scalar_type(v)) for v in (a, b, *share / length ** np.arange(3))
    ]
    inside = c[2] + (c[3] + c[4] * (x - c[0])) * (x - c[0])
    return ufl.conditional(x > c[1], 1.0, ufl.conditional(x > c[0], inside, 0.0))


def solve_patch(
    slave="lower", lower=None, upper=None, *, angle=0.0, cell="triangle", hold="edge", degree=1
):
    """Press the upper block on the lower one; return problem, contact and the exact solution."""
    lower = np.linspace(0, 1, 4) if lower is None else np.asarray(lower)
    upper = np.linspace(0, 1, 5) if upper is None else np.asarray(upper)
    sizes = {"n_lower": (len(lower) - 1, 3), "n_upper": (len(upper) - 1, 4)}
    case = TwoBodies(cell, degree, splits_lower=lower, splits_upper=upper, angle=angle, **sizes)
    mesh, V, exact, R = case.mesh, case.V, fem.Function(case.V), rotation((0, 0, 1), angle)[:2, :2]
    strain = P / E * R @ np.diag([NU * (1 + NU), NU**2 - 1]) @ R.T
    exact.interpolate(lambda x: strain @ x[:2])
    t, n = (fem.Constant(mesh, c.astype(default_scalar_type)) for c in R.T)
    v, ds = ufl.TestFunction(V), ufl.Measure("ds", mesh, subdomain_data=case.facets)
    x = ufl.dot(ufl.SpatialCoordinate(mesh), t)
    loads = -P * ufl.dot(n, v) * ds(TOP)
    # Where one block sticks out beyond the other, the pressure acts on it directly.
    for tag, lines, end, sign in ((3, lower, upper[-1], 1.0), (4, upper, lower[-1], -1.0)):
        loads += -sign * P * beyond(mesh, x, end, lines, degree) * ufl.dot(n, v) * ds(tag)
    if hold == "edge":  # slave ends on a Dirichlet edge; nothing holds the upper block vertically
        lift = (1 - NU**2) / E * P  # of the bottom; the interface stays
        bcs = [case.held(LEFT, 0.0, 0), case.held(BOTTOM, lift, 1)]
    else:  # the bottom moves as it would, one node on top is held
        top = fem.locate_dofs_geometrical(
            V, lambda y: np.isclose(R.T[0] @ y[:2], upper[0]) & np.isclose(R.T[1] @ y[:2], 1.0)
        )
        bcs = [case.held(BOTTOM, exact), fem.dirichletbc(exact, top)]
    contact = case.interface(swap=slave == "upper")
    options = {"loads": loads, "geometry": "reference"}
    return case.problem([contact], bcs, dm.Elastic(E, NU), **options), contact, exact


def check(problem, contact, exact):
    """Solve and compare displacement and pressure with the constant stress state."""
    report = dm.newton(problem, rtol=1e-11)
    assert largest(problem.u.x.array - exact.x.array) < EXACT * largest(exact.x.array)
    link = problem.system.link(contact)
    assert largest(contact.multiplier[link.constrained[:, 0]] - P) < EXACT * P
    on_slave = link.sides.on_slave & (contact.pressure.x.array != 0)
    assert largest(contact.pressure.x.array[on_slave] - P) < EXACT * P
    assert report.certificate.equilibrium < EXACT
    assert report.certificate.force_balance < EXACT


LENGTHS = {
    "equal": (None, None),
    "lower longer": (np.linspace(0, 1.5, 6), np.linspace(0, 1, 5)),
    "upper longer": (np.linspace(0, 1, 4), np.linspace(0, 1.3, 7)),
    "ends on a node": (np.linspace(0, 2, 7), np.linspace(0, 1, 5)),
}


@pytest.mark.mpi
@pytest.mark.parametrize("hold", ["edge", "node"])
@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("slave", ["lower", "upper"])
@pytest.mark.parametrize(("lengths", "cell"), zip(LENGTHS, CELLS[:2] * 2, strict=True))
def test_unequal_lengths(lengths, cell, slave, degree, hold):
    """The slave side is longer or shorter, ends on a Dirichlet edge or free, then inclined."""
    angle = 0.0 if hold == "edge" else np.pi / 6
    options = {"angle": angle, "cell": cell, "hold": hold, "degree": degree}
    check(*solve_patch(slave, *LENGTHS[lengths], **options))


@pytest.mark.parametrize("slave", ["lower", "upper"])
@pytest.mark.parametrize("covered", [0.5, 0.05, pytest.param(1e-6, marks=pytest.mark.mpi)])
@pytest.mark.parametrize("degree", [1, 2])
def test_little_coverage(slave, covered, degree):
    """The last facet of the slave side is covered by a small part of its length."""
    end = 1 - 0.4 * covered
    short = np.array([0, 0.21, 0.5, 0.77, 1.0])
    long = np.array([0, 0.35, 0.7, end, end + 0.4])
    lines = (long, short) if slave == "lower" else (short, long)
    problem, contact, exact = solve_patch(slave, *lines, degree=degree)
    check(problem, contact, exact)
    # a node that too little faces has no multiplier of its own: a neighbour has its share
    kept = COMM.allreduce(int(np.sum(problem.system.link(contact).coupling.kept)))
    c = covered  # shares of the integrals of the end's function, and of the middle's
    shares = [c**2] if degree == 1 else [4 * c**3 - 3 * c**2, 3 * c**2 - 2 * c**3]
    assert kept == degree * (len(long) - 1) + 1 - sum(share <= 0.05 for share in shares)


widths = st.lists(st.floats(0.2, 1.0), min_size=1, max_size=5)


@hypothesis.settings(max_examples=15)
@hypothesis.given(
    lower=widths,
    upper=widths,
    length=st.floats(0.7, 1.4),
    slave=st.sampled_from(["lower", "upper"]),
    angle=st.sampled_from([0.0, 0.4, np.pi / 6, 2.0]),
    degree=st.sampled_from([1, 2]),
)
def test_random_splits(lower, upper, length, slave, angle, degree):
    lines = [np.concatenate([[0.0], np.cumsum(w)]) / np.sum(w) for w in (lower, upper)]
    lines[1] = lines[1] * length
    check(*solve_patch(slave, *lines, angle=angle, hold="node", degree=degree))


STRAIN = np.diag([NU / E * P, NU / E * P, -P / E])  # of the uniaxial stress -P along z


@pytest.mark.mpi
@pytest.mark.parametrize("turn", [None, rotation((1.0, 2.0, 0.5), 0.7)], ids=["level", "inclined"])
@pytest.mark.parametrize(
    ("cell", "degree", "swap"),
    [(cell, k, k == 1) for cell in CELLS[2:] for k in (1, 2)],
)
def test_boxes_in_space(cell, degree, swap, turn):
    """Symmetry planes cut through the contact; or nothing holds its edges, and it is inclined."""
    R, jitter = (np.eye(3), 0.0) if turn is None else (turn, 0.4)
    sizes = {"n_lower": (2, 2, 2), "n_upper": (3, 3, 2)}
    case = TwoBodies(cell, degree, turn=turn, jitter=jitter, **sizes)
    exact, strain = fem.Function(case.V), R @ STRAIN @ R.T
    exact.interpolate(lambda x: strain @ x[:3])
    if turn is None:
        bcs = [case.held(LEFT, 0.0, 0), case.held(FRONT, 0.0, 1), case.held(BOTTOM, P / E, 2)]
    else:
        edge = fem.locate_dofs_geometrical(
            case.V, lambda x: np.isclose((R.T @ x)[0], 0) & np.isclose((R.T @ x)[2], 1)
        )
        bcs = [case.held(BOTTOM, exact), fem.dirichletbc(exact, edge)]
    n = fem.Constant(case.mesh, R[:, 2].astype(default_scalar_type))
    ds = ufl.Measure("ds", case.mesh, subdomain_data=case.facets)
    loads = -P * ufl.dot(n, ufl.TestFunction(case.V)) * ds(TOP)
    contact, options = case.interface(swap=swap), {"loads": loads, "geometry": "reference"}
    check(case.problem([contact], bcs, dm.Elastic(E, NU), **options), contact, exact)
