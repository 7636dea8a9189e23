# SPDX-License-Identifier: MIT
"""The exact tangent of moving geometry in 3D: its rate, and when it is used."""

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_mortar as dm
from dolfinx import fem
from dolfinx_mortar.algebra.parallel import maximum
from dolfinx_mortar.steps.subproblem import Subproblem
from tests.cases import meshes_3d
from tests.cases.ball import STEEL, create_mesh
from tests.cases.two_bodies import TwoBodies, create_problem, held
from tests.choice import crosswise

FACTORISED = {"pc_type": "cholesky"}


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
    ):
        """Create the problem."""
        m = create_mesh(h, cell)
        V = fem.functionspace(m.mesh, ("Lagrange", degree, (3,)))
        self.motion = [fem.Constant(m.mesh, 0.0) for _ in range(3)]
        places = [(1, i, 0.0) for i in range(3)] + [(2, i, self.motion[i]) for i in range(3)]
        bcs = [held(V, m.facet_tags, tag, value, i) for tag, i, value in [*places, (5, 0, 0.0)]]
        slave = 3 if slave == "block" else 4
        self.contact = dm.Contact(m.facet_tags, slave=slave, master=7 - slave, surface=surface)
        self.problem = create_problem(V, [self.contact], bcs, STEEL, petsc_options=options)

    def step(self, along):
        """Return the report of a step to a depth of 0.2 and a place along the block."""
        self.motion[1].value, self.motion[2].value = along, -0.2
        report = dm.newton(self.problem, rtol=1e-10)
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
    monkeypatch.setattr(Subproblem, "may_be_exact", False)
    case = Sliding(slave, surface=surface)
    case.step(0.0)
    slow = case.step(0.6)
    assert not any(i.exact_tangent for i in slow.iterations)
    assert slow.newton_iterations >= report.newton_iterations + 5
    assert np.abs(case.contact.force - force).max() < 1e-8 * np.abs(force).max()


@pytest.mark.mpi
def test_multigrid_of_the_symmetric_matrix_serves(monkeypatch):
    """GMRES takes at most 15 iterations more than conjugate gradients; the answer is the same."""
    found = {}
    for exact in (True, False):
        if not exact:
            monkeypatch.setattr(Subproblem, "may_be_exact", False)
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


class Stuck:
    """Two blocks of rubber that stick to each other, whose ends can be turned and moved."""

    def __init__(self, cell, degree):
        """Create them."""
        case = TwoBodies(
            cell, degree, n_lower=(2, 2, 1), n_upper=(3, 3, 1), upper=(0.15, 0.8, 0.2, 0.9),
            heights=(0.5, 0.5), jitter=0.15,
        )  # fmt: skip
        self.ends = [fem.Function(case.V), fem.Function(case.V)]
        sides = zip((meshes_3d.BOTTOM, meshes_3d.TOP), self.ends, strict=True)
        self.contact = case.interface(friction=2.0, surface="facets")
        options = {"strain": "finite", "petsc_options": {"pc_type": "lu"}}
        bcs, law = [case.held(tag, end) for tag, end in sides], dm.NeoHooke(1.0, 0.3)
        self.problem = case.problem([self.contact], bcs, law, **options)

    def step(self, turn, pushed):
        """Turn all after the upper end has moved; return the nodal contact forces, turned back."""
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
        pytest.param("hexahedron", 2, marks=pytest.mark.slow),
    ],
)
def test_a_stuck_pair_that_turns_keeps_its_nodal_forces(cell, degree):
    """Those of all nodes, to round-off, after 90 degrees in two steps about an oblique axis."""
    case, pushed = Stuck(cell, degree), (0.02, 0.01, -0.06)
    case.step(np.eye(3), (0.0, 0.0, -0.05))
    before = case.step(np.eye(3), pushed)
    largest = maximum(MPI.COMM_WORLD, np.abs(before).max(initial=0.0))[0]
    assert largest > 1e-3
    for angle in (np.pi / 4, np.pi / 2):
        after = case.step(meshes_3d.rotation((1.0, 2.0, 3.0), angle), pushed)
        difference = maximum(MPI.COMM_WORLD, np.abs(after - before).max(initial=0.0))[0]
        assert difference < 1e-11 * largest
