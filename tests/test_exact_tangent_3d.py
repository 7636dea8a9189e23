# SPDX-License-Identifier: MIT
"""The exact tangent of moving geometry in 3D: its derivatives, its rate, and when it is used."""

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_mortar as dm
import dolfinx_mortar.steps.newton as newton_module
from dolfinx import fem
from dolfinx_mortar.algebra import congruence, triplets
from dolfinx_mortar.algebra.parallel import maximum
from dolfinx_mortar.mortar import curvature_correction
from dolfinx_mortar.mortar.integrals import (
    find_segments,
)
from dolfinx_mortar.mortar.tangent import differentiate
from dolfinx_mortar.newton_method.contacts import Contacts
from dolfinx_mortar.newton_method.watch import contact_forces
from tests import meshes_3d, on_edges
from tests.ball_case import STEEL, create_mesh
from tests.choice import crosswise, quick
from tests.meshes import BOTTOM_OF_UPPER, TOP_OF_LOWER
from tests.rough_sides import RoughSides, summed

COMM = MPI.COMM_SELF
FACTORISED = {"pc_type": "cholesky"}


class Rough(RoughSides):
    """Two rough, bent sides, with random tractions."""

    def __init__(
        self,
        cell,
        n_lower,
        n_upper,
        *,
        upper,
        seed,
        smooth=False,
        degree=1,
        order=1,
        noise=0.03,
        jitter=0.2,
        shared=True,
    ):
        """Create them; the slave is the upper side of the lower box."""
        rng = np.random.default_rng(seed)
        sizes, kind = ((*n_lower, 1), (*n_upper, 1)), {"cell": cell, "order": order}
        mesh, _, facets = meshes_3d.two_boxes(
            COMM, *sizes, upper=upper, jitter=jitter, seed=seed, **kind
        )
        V = fem.functionspace(mesh, ("Lagrange", degree, (3,)))
        u, X = fem.Function(V), V.tabulate_dof_coordinates()
        u.x.array[:] = noise * rng.standard_normal(u.x.array.size)
        u.x.array[2::3] -= 0.2 * (X[:, 0] - 0.4) ** 2 - 0.1 * X[:, 0] * X[:, 1]
        turn = meshes_3d.rotation((1.0, 2.0, 3.0), 0.7)
        sagittas = (0.02, 0.05) if smooth else None
        super().__init__(u, facets, turn, rng, sagittas=sagittas, shared=shared)


def errors(rough, directions=None):
    """Return the errors of the derivatives, over the largest entries."""
    found = rough.derivatives()
    if directions is not None:
        found = [A @ directions.reshape(len(directions), -1).T for A in found]
    both = zip(found, rough.differences(directions), strict=True)
    return [np.abs(found - expected).max() / np.abs(expected).max() for found, expected in both]


@pytest.fixture
def accurate(monkeypatch):
    """See `on_edges.integrate_accurately`."""
    on_edges.integrate_accurately(monkeypatch)


UNDER = (-0.5, 1.6, -0.5, 1.5)
UNIT = (0.0, 1.0, 0.0, 1.0)
PARTLY = (0.2, 1.3, -0.1, 0.7)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("upper", [UNDER, PARTLY])
@pytest.mark.parametrize("cell", ["tetrahedron", "hexahedron"])
def test_derivatives_of_one_pair(cell, upper, seed, accurate):
    """Of one facet (two triangles) a side, which lies under the master or reaches beyond it."""
    rough = Rough(cell, (1, 1), (1, 1), upper=upper, seed=seed)
    assert max(errors(rough)) < 1e-8


@pytest.mark.parametrize(
    ("upper", "degree", "order"), crosswise([(UNDER,), (PARTLY,)], [(1, 1), (2, 1), (2, 2)])
)
def test_derivatives_of_smooth_heights(upper, degree, order, accurate, monkeypatch):
    """Strains, by which heights of second order change, are held."""
    held = lambda surface, u: np.ones(len(surface.nodes))  # noqa: E731
    monkeypatch.setattr(curvature_correction, "thickness_stretches", held)
    options = {"smooth": True, "degree": degree, "order": order}
    rough = Rough("hexahedron", (1, 1), (1, 1), upper=upper, seed=3, **options)
    assert max(errors(rough)) < 1e-8


@pytest.mark.parametrize("cell", ["tetrahedron", "hexahedron"])
def test_derivatives_are_those_of_forces_and_gaps(cell, accurate):
    """Of random tractions on sides that cover each other in part; to 1e-8 of the largest entry."""
    rough = Rough(cell, (3, 3), (2, 3), upper=PARTLY, seed=3)
    assert 0 < rough.keep.sum() < len(rough.keep)
    assert max(errors(rough)) < 1e-8


def test_derivatives_where_facets_are_open_closed_and_between(monkeypatch):
    """Beside open edges, one after the other."""
    on_edges.count_all_parts(monkeypatch)
    rough = Rough("tetrahedron", (3, 3), (2, 3), upper=PARTLY, seed=3, shared=False)
    closed = rough.sharing(find_segments(rough.pairing, rough.u)[0]).closed
    between = (closed > 0.0) & (closed < 1.0)
    assert between.any() and (closed[between.argmax() :] == 0.0).any()
    assert max(errors(rough)) < 1e-8


@pytest.mark.parametrize("cell", ["tetrahedron", "hexahedron"])
def test_derivatives_where_edges_nearly_coincide(cell):
    """Corners of segments move a thousand times as fast as nodes, errors of quadrature do not."""
    rough = Rough(cell, (2, 2), (2, 2), upper=UNIT, seed=4, smooth=True, noise=2e-3, jitter=0.0)
    directions = np.random.default_rng(0).standard_normal((3, len(rough.nodes), 3))
    assert max(errors(rough, 1e-2 * directions)) < 2e-3


@pytest.mark.parametrize(("order", "cell"), crosswise([1, 2], ["tetrahedron", "hexahedron"]))
@pytest.mark.parametrize("upper", [UNDER, PARTLY])
def test_derivatives_in_second_order(cell, order, upper, accurate):
    """Of straight and of curved cells, in random directions.

    Where facets meet, what one of them gains the other one does not lose: their common edge is
    clipped as a straight line, beside which both are continued.
    """
    second = {"degree": 2, "order": order, "noise": 0.01}
    rough = Rough(cell, (2, 3), (3, 2), upper=upper, seed=2, **second)
    assert rough.keep.all() == (upper == UNDER)
    directions = np.random.default_rng(0).standard_normal((2, len(rough.nodes), 3))
    assert max(errors(rough, directions)) < 1e-8


@pytest.mark.parametrize("cell", ["tetrahedron", "hexahedron"])
def test_derivatives_of_what_faces_a_node(cell, accurate):
    """Of sum_l M_jl n_l, n_l fixed."""
    rough = Rough(cell, (2, 3), (1, 1), upper=UNDER, seed=1, noise=0.01)
    rng, own, pairing = np.random.default_rng(0), len(rough.slave.nodes), rough.pairing
    n, v = (rng.standard_normal((len(of), 3)) for of in (pairing.master_nodes, rough.nodes))

    def facing(size):
        before = rough.u.x.array.copy()
        rough.u.x.array.reshape(-1, 3)[rough.nodes] += size * v
        segments, _ = find_segments(pairing, rough.u)
        N = pairing.master.element.shape_functions(segments.xi_m)
        at = np.einsum("ql,qli->qi", N, n[pairing.master_facets[segments.master]])
        result, Phi = np.zeros((own, 3)), rough.duals(segments)
        np.add.at(result, rough.slave.facets[segments.slave], Phi[:, :, None] * at[:, None])
        rough.u.x.array[:] = before
        return result.ravel()

    segments, normals = find_segments(pairing, rough.u)
    at = pairing, rough.u, segments, rough.keep, rough.given(normals)
    found = summed(differentiate(*at, normals=n).b_x, (3 * own, 3 * len(rough.nodes))) @ v.ravel()
    expected = (facing(1e-5) - facing(-1e-5)) / 2e-5
    assert rough.keep.all()
    assert np.allclose(found, expected, rtol=0.0, atol=1e-7 * np.abs(expected).max())


def wavy(X, phase):
    """Return vectors at points, the same on all ranks."""
    parts = [np.sin(X @ np.array(k) + phase + i) for i, k in enumerate([(9, 7, 5), (5, 9, 8)])]
    return np.stack([parts[0], parts[1], parts[0] * parts[1]], axis=1)


def partly_covered(cell, friction, degree):
    """Return a problem of two boxes that cover each other in part."""
    mesh, _, facets = meshes_3d.two_boxes(
        MPI.COMM_WORLD, (4, 4, 1), (3, 5, 1), upper=PARTLY, cell=cell, jitter=0.2
    )
    V = fem.functionspace(mesh, ("Lagrange", degree, (3,)))
    bcs = []
    for tag in (meshes_3d.BOTTOM, meshes_3d.TOP):
        dofs = fem.locate_dofs_topological(V, 2, facets.find(tag))
        bcs.append(fem.dirichletbc(fem.Constant(mesh, (0.0, 0.0, 0.0)), dofs, V))
    sides = {"slave": meshes_3d.TOP_OF_LOWER, "master": meshes_3d.BOTTOM_OF_UPPER}
    contact = dm.Contact(facets, **sides, surface="facets", friction=friction or None)
    solid = dm.Solid(fem.Function(V), dm.Elastic(E=1.0, nu=0.3))
    return dm.ContactProblem(solid, [contact], bcs=bcs, geometry="updated")


@pytest.mark.mpi
@pytest.mark.parametrize(
    ("cell", "friction", "degree"),
    [
        ("tetrahedron", 0.0, 1),
        ("tetrahedron", 0.3, 1),
        ("hexahedron", 0.0, 1),
        ("hexahedron", 0.3, 1),
        ("tetrahedron", 0.3, 2),
    ],
)
def test_tangent_of_a_problem_is_that_of_its_forces_and_gaps(cell, friction, degree, accurate):
    """On any number of ranks: in a direction, with tractions that vary from node to node."""
    problem = partly_covered(cell, friction, degree)
    solid, mesh, X = problem.solid, problem.V.mesh, problem.V.tabulate_dof_coordinates()
    u, v = (scale * wavy(X, phase).ravel() for scale, phase in ((0.03, 0.0), (1.0, 2.0)))
    solid.u.x.array[:] = u
    problem.begin_step(audit=False)
    solid.u.x.array[:] = u
    problem.follow_geometry()
    (link,) = problem.system.unilateral
    on = link.near & link.coupling.kept[:, 0]
    lam = np.zeros(problem.n)
    lam[link.nodes[on]] = 1.0 + 0.5 * wavy(X, 1.0)[link.nodes[on], 0]

    def tangential(link):
        """Return vectors that turn with the surface."""
        if not friction:
            return None
        vectors, n = wavy(X, 3.0)[: problem.n], np.zeros((problem.n, 3))
        n[link.nodes] = link.coupling.normals
        for normal in (first, n):
            vectors = vectors - (vectors * normal).sum(axis=1)[:, None] * normal
        vectors[lam == 0.0] = 0.0
        return vectors

    first = np.zeros((problem.n, 3))
    first[link.nodes] = link.coupling.normals

    def moved(step):
        solid.u.x.array[:] = u + step * v
        problem.follow_geometry()
        (link,) = problem.system.unilateral
        forces = contact_forces(problem, Contacts(lam > 0.0, lam, tangential(link)))
        return forces, (link.gaps(problem.positions()) * link.coupling.weight[:, 0])[on]

    found = problem.system.linearise_geometry(
        solid.u, lam, tangential(link), (problem.vector(), ())
    )
    (H,) = found.forces
    direction = problem.vector(v[: 3 * problem.n])
    by_force, by_gap = np.array((H * direction).array_r), found.closing(direction)
    by_gap = (-by_gap[3 * link.nodes] * link.coupling.weight[:, 0])[on]
    with on_edges.linear_normals(problem):
        high, low = moved(2e-6), moved(-2e-6)  # errors are of the second order
    for tangent, a, b in zip((by_force, by_gap), high, low, strict=True):
        difference = (a - b) / 4e-6
        errors = np.abs(tangent - difference).max(initial=0.0), np.abs(difference).max(initial=0.0)
        error, size = maximum(mesh.comm, *errors)
        assert error < 1e-8 * size


@pytest.mark.mpi
@pytest.mark.parametrize(
    ("slave", "cell"), crosswise(["ball", "block"], ["hexahedron", "tetrahedron"])
)
def test_rows_of_gaps_and_slips_are_their_derivatives(slave, cell, accurate, monkeypatch):
    """The trial rows of T_g, with what lumping leaves to the bounds; differences agree to 1e-8.

    They are extrapolated: of warped facets a simple one has an error of 6e-7. Slips are vectors:
    their components along tangents that do not spin about the normal.
    """
    on_edges.count_all_parts(monkeypatch)
    case = Sliding(slave, cell=cell, friction=0.3, options=None)
    problem = case.problem
    for along in (0.0, 0.1):
        case.step(along, rtol=1e-6)
    case.motion[1].value = 0.3
    data, X = problem.begin_step(), problem.X
    u = problem.owned_u
    u += 3e-3 * wavy(X, 0.0).ravel()  # far from balance, so that all terms count
    start, du = u.copy(), wavy(X, 1.0).ravel()

    def at(step):
        u[:] = start + step * du
        problem.u.x.scatter_forward()
        problem.follow_geometry()
        (link,) = problem.system.unilateral
        since = problem.vector(u - problem.committed.displacement)
        slip = data.partners[0].slip(link, since)[:, 1:]
        slip = np.einsum("nij,nj->ni", link.coupling.R[:, :, 1:], slip)
        gaps = link.coupling.weight[:, 0] * link.gaps(problem.positions())
        return link, since, gaps, slip

    at(0.0)
    with on_edges.linear_normals(problem):
        long, short = (
            [(a - b) / (2 * step) for a, b in zip(at(step)[2:], at(-step)[2:], strict=True)]
            for step in (2e-5, 1e-5)
        )
    gap, slip = ((4 * a - b) / 3 for a, b in zip(short, long, strict=True))
    link, since, *_ = at(0.0)
    near = link.near & link.coupling.kept[:, 0] & data.partners[0].known
    multipliers = np.zeros(problem.n)
    multipliers[link.nodes[near]] = 1.0
    given = multipliers, np.zeros((problem.n, 3)), (since, data.partners)
    closing = problem.system.linearise_geometry(problem.u, *given).closing(problem.vector(du))
    found = closing.reshape(-1, 3)[link.nodes]
    in_frames = np.einsum("nij,ni->nj", link.coupling.R[:, :, 1:], slip)
    closed = found[:, 0] * link.coupling.weight[:, 0]
    for error, size in ((closed + gap, gap), (found[:, 1:] - in_frames, in_frames)):
        largest = maximum(problem.comm, *(np.abs(v[near]).max(initial=0.0) for v in (error, size)))
        assert largest[0] < 1e-8 * largest[1]
    assert problem.comm.allreduce(int(near.sum())) > 5


SMALL, BESIDE, CORNER, LITTLE = (
    (0.23, 0.77, 0.21, 0.75),
    (0.43, 1.37, -0.1, 1.12),
    (0.43, 1.37, 0.38, 1.41),
    (0.97, 1.87, 0.38, 1.41),
)
ON_EDGES = {
    "corners of the slave": (SMALL, BOTTOM_OF_UPPER, TOP_OF_LOWER, 0.0),
    "edge on edge": (BESIDE, BOTTOM_OF_UPPER, TOP_OF_LOWER, 0.0),
    "edge on edge, swapped": (BESIDE, TOP_OF_LOWER, BOTTOM_OF_UPPER, 0.0),
    "corner on corner": (CORNER, BOTTOM_OF_UPPER, TOP_OF_LOWER, 0.0),
    "corner on corner, swapped": (CORNER, TOP_OF_LOWER, BOTTOM_OF_UPPER, 0.0),
    "open": (LITTLE, BOTTOM_OF_UPPER, TOP_OF_LOWER, 0.004),
    "open, swapped": (LITTLE, TOP_OF_LOWER, BOTTOM_OF_UPPER, 0.004),
}


@pytest.mark.mpi
@pytest.mark.parametrize(
    ("name", "cell", "degree"),
    quick(
        [
            (name, cell, degree)
            for name in ON_EDGES
            for cell in ("tetrahedron", "hexahedron")
            for degree in (1, 2)
        ],
        ("edge on edge", "tetrahedron", 1),
        ("corner on corner, swapped", "hexahedron", 1),
        ("open", "tetrahedron", 1),
        ("open, swapped", "hexahedron", 1),
    ),
)
def test_derivatives_at_edges_are_those_of_forces_gaps_and_slips(name, cell, degree, accurate):
    """With the normals of edges, and what open facets share out; to 1e-8 of the largest entry."""
    upper, slave, master, up = ON_EDGES[name]
    n = ((4, 4, 1), (3, 3, 1)) if upper == SMALL else ((3, 3, 1), (3, 3, 1))
    mesh = meshes_3d.two_boxes(MPI.COMM_WORLD, *n, upper=upper, cell=cell, jitter=0.15)
    problem, data = on_edges.begin(*mesh, degree, slave, master, surface="facets")
    on_edges.raise_upper(problem, up)
    tangent = on_edges.Tangent(problem, data, noise=1e-3)
    assert tangent.on_edges > 0
    assert not up or tangent.open_in_part() > 0
    assert max(tangent.errors) < 1e-8


class Sliding:
    """Half of a ball, pressed into half of a block and moved along the plane of symmetry."""

    def __init__(
        self,
        slave="block",
        *,
        surface="facets",
        cell="hexahedron",
        degree=1,
        h=0.5,
        options=FACTORISED,
        **friction,
    ):
        """Create the problem."""
        m = create_mesh(h, cell)
        V = fem.functionspace(m.mesh, ("Lagrange", degree, (3,)))
        self.motion = [fem.Constant(m.mesh, 0.0) for _ in range(3)]
        zero = fem.Constant(m.mesh, 0.0)
        bcs = []
        held = [(1, i, zero) for i in range(3)] + [(2, i, self.motion[i]) for i in range(3)]
        for tag, component, value in [*held, (5, 0, zero)]:
            W = V.sub(component)
            dofs = fem.locate_dofs_topological(W, 2, m.facet_tags.find(tag))
            bcs.append(fem.dirichletbc(value, dofs, W))
        sides = dict(zip(("slave", "master"), (3, 4) if slave == "block" else (4, 3), strict=True))
        self.contact = dm.Contact(m.facet_tags, **sides, surface=surface, **friction)
        solid = dm.Solid(fem.Function(V), STEEL)
        self.problem = dm.ContactProblem(solid, [self.contact], bcs=bcs, petsc_options=options)

    def step(self, along, rtol=1e-10):
        """Return the report of a step to a depth of 0.2 and a place along the block."""
        self.motion[1].value, self.motion[2].value = along, -0.2
        report = dm.newton(self.problem, rtol=rtol)
        self.problem.commit()
        return report


def residuals(report):
    """Return the residuals of the iterations with the exact tangent, and the two before."""
    worst = [max(i.force_residual, i.contact_residual) for i in report.iterations]
    first = next(k for k, i in enumerate(report.iterations) if i.exact_tangent)
    assert all(i.exact_tangent for i in report.iterations[first:])
    return np.array(worst[first - 2 :])


@pytest.mark.parametrize(("surface", "slave"), crosswise(["facets", "smooth"], ["block", "ball"]))
def test_newton_is_fast_at_the_end_and_the_answer_the_same(slave, surface, monkeypatch):
    """What turns normals of contact in space and is left out gives a factor of .002 to .006."""
    case = Sliding(slave, surface=surface)
    case.step(0.0)
    report = case.step(0.6)
    r = residuals(report)
    ratios = r[1:] / r[:-1]
    assert ratios[1] < 0.1 * ratios[0]
    assert ratios[2:].max() < 0.02
    force = case.contact.force
    monkeypatch.setattr(newton_module._Step, "may_be_exact", False)
    case = Sliding(slave, surface=surface)
    case.step(0.0)
    slow = case.step(0.6)
    assert not any(i.exact_tangent for i in slow.iterations)
    assert slow.newton_iterations >= report.newton_iterations + 5
    assert np.abs(case.contact.force - force).max() < 1e-8 * np.abs(force).max()


@pytest.mark.slow
def test_newton_is_fast_in_second_order():
    """As in first order."""
    case = Sliding("ball", degree=2, h=1.0)
    case.step(0.0)
    ratios = np.exp(np.diff(np.log(residuals(case.step(0.6)))))
    assert ratios[1] < 0.1 * ratios[0]
    assert ratios[2:].max() < 0.02


@pytest.mark.slow
@pytest.mark.parametrize(("cell", "slave"), [("tetrahedron", "block"), ("hexahedron", "ball")])
def test_strains_in_heights_slow_newton_down_by_little(cell, slave, monkeypatch):
    """In second order: left out, they leave a linear tail with a factor of less than a fiftieth.

    The answer is that of the fixed point, which takes five iterations more at least.
    """
    case = Sliding(slave, surface="smooth", cell=cell, degree=2, h=1.0)
    case.step(0.0)
    report = case.step(0.6)
    r = residuals(report)
    ratios = r[1:] / r[:-1]
    assert ratios[1] < 0.1 * ratios[0]
    assert ratios[2:].max() < 0.02
    force = case.contact.force
    monkeypatch.setattr(newton_module._Step, "may_be_exact", False)
    case = Sliding(slave, surface="smooth", cell=cell, degree=2, h=1.0)
    case.step(0.0)
    assert case.step(0.6).newton_iterations >= report.newton_iterations + 5
    assert np.abs(case.contact.force - force).max() < 1e-8 * np.abs(force).max()


@pytest.mark.mpi
def test_multigrid_of_the_symmetric_matrix_serves(monkeypatch):
    """GMRES takes at most 15 iterations more than conjugate gradients; the answer is the same."""
    found = {}
    for exact in (True, False):
        if not exact:
            monkeypatch.setattr(newton_module._Step, "may_be_exact", False)
        case = Sliding(options=None)
        case.step(0.0)
        report = case.step(0.6)
        assert any(i.exact_tangent for i in report.iterations) == exact
        found[exact] = report.iterations, case.contact.force
        assert report.linear_solver == "cg + gamg"
    (fast, force), (slow, expected) = found[True], found[False]
    assert len(slow) >= len(fast) + 4
    most = max(i.linear_iterations for i in slow)
    assert max(i.linear_iterations for i in fast if i.exact_tangent) <= most + 15
    assert sum(i.factorisations for i in fast) <= sum(i.factorisations for i in slow)
    assert np.abs(force - expected).max() < 1e-8 * np.abs(expected).max()


def test_nothing_is_allocated_anew_in_the_next_step(monkeypatch):
    """Patterns and symbolic factorisations serve until the surfaces are paired anew."""
    case, made = Sliding(), []
    case.step(0.0)
    assert any(i.exact_tangent for i in case.step(0.6).iterations)
    for kind in (triplets.Triplets, congruence.ProductOfBases, congruence.Congruence):
        monkeypatch.setattr(kind, "__init__", lambda self, *args: made.append(type(self)))
    before = case.problem.linear.counts.symbolic
    assert sum(i.exact_tangent for i in case.step(0.65).iterations) > 1
    assert case.problem.linear.counts.symbolic == before
    assert made == []


class Stuck:
    """Two blocks of rubber that stick to each other, whose ends can be turned and moved."""

    def __init__(self, cell, degree):
        """Create them."""
        mesh, _, facets = meshes_3d.two_boxes(
            MPI.COMM_WORLD,
            (2, 2, 1),
            (3, 3, 1),
            cell=cell,
            upper=(0.15, 0.8, 0.2, 0.9),
            heights=(0.5, 0.5),
            jitter=0.15,
        )
        V = fem.functionspace(mesh, ("Lagrange", degree, (3,)))
        self.ends, bcs = [fem.Function(V), fem.Function(V)], []
        for end, tag in zip(self.ends, (meshes_3d.BOTTOM, meshes_3d.TOP), strict=True):
            dofs = fem.locate_dofs_topological(V, 2, facets.find(tag))
            bcs.append(fem.dirichletbc(end, dofs))
        sides = {"slave": meshes_3d.TOP_OF_LOWER, "master": meshes_3d.BOTTOM_OF_UPPER}
        self.contact = dm.Contact(facets, **sides, friction=2.0, surface="facets")
        solid = dm.Solid(fem.Function(V), dm.NeoHooke(1.0, 0.3), strain="finite")
        self.problem = dm.ContactProblem(
            solid, [self.contact], bcs=bcs, petsc_options={"pc_type": "lu"}
        )

    def step(self, turn, pushed):
        """Turn all after the upper end has moved; return the nodal contact forces, turned back.

        Of owned nodes: tractions times D_jj.
        """
        for end, shift in zip(self.ends, (np.zeros(3), np.array(pushed)), strict=True):
            end.interpolate(lambda X, shift=shift: turn @ (X + shift[:, None]) - X)
        dm.newton(self.problem, rtol=1e-11)
        self.problem.commit()
        assert not (self.contact.status.x.array == 2.0).any()  # no slip
        (link,) = self.problem.system.unilateral
        tractions = self.contact.traction.x.array.reshape(-1, 3)[link.nodes]
        return link.coupling.weight[:, :1] * tractions @ turn


@pytest.mark.mpi
@pytest.mark.parametrize(
    ("cell", "degree"),
    [
        ("tetrahedron", 1),
        pytest.param("hexahedron", 1, marks=pytest.mark.slow),
        pytest.param("tetrahedron", 2, marks=pytest.mark.slow),
    ],
)
def test_a_stuck_pair_that_turns_keeps_its_nodal_forces(cell, degree):
    """Those of all nodes, to round-off, after 90 degrees in two steps about an oblique axis.

    So it spins about its normal, too. Displacements differ by 1e-15 then, internal forces by 8 eps
    of modulus times side squared at any node: tractions of a node of second order with a D_jj of
    6 % of the largest differ by 1e-11, the nodal forces by 2e-12.
    """
    case, pushed = Stuck(cell, degree), (0.02, 0.01, -0.06)
    case.step(np.eye(3), (0.0, 0.0, -0.05))
    before = case.step(np.eye(3), pushed)
    largest = maximum(MPI.COMM_WORLD, np.abs(before).max(initial=0.0))[0]
    assert largest > 1e-3
    for angle in (np.pi / 4, np.pi / 2):
        after = case.step(meshes_3d.rotation((1.0, 2.0, 3.0), angle), pushed)
        difference = maximum(MPI.COMM_WORLD, np.abs(after - before).max(initial=0.0))[0]
        assert difference < 1e-11 * largest
