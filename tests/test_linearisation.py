# SPDX-License-Identifier: MIT
"""The QP of an iterate: the same in either form; a constant tangent is not assembled again."""

from petsc4py import PETSc

import numpy as np
import pytest

import dolfinx_mortar as dm
import ufl
from dolfinx import default_scalar_type, fem
from dolfinx_mortar.problem.linearisation import find_balance, linearise
from tests.cases.meshes import TOP
from tests.cases.pressed_blocks import PressedBlocks

pytestmark = pytest.mark.mpi
SOLVERS = {"direct": {}, "iterative": {"pc_type": "gamg"}}


@pytest.mark.parametrize(
    ("solver", "what"), [("iterative", "nothing"), ("direct", "springs"), ("direct", "modulus")]
)
def test_a_linear_tangent_is_assembled_once(solver, what, monkeypatch):
    """Over all steps; once a step where a user may change values: of a potential, of parameters."""
    case, calls = PressedBlocks(), []
    assemble = dm.Solid.add_tangent
    monkeypatch.setattr(
        dm.Solid, "add_tangent", lambda self, K, p=None: (calls.append(K), assemble(self, K, p))
    )
    k, E = (fem.Constant(case.mesh, default_scalar_type(1.0)) for _ in range(2))
    ds = ufl.Measure("ds", case.mesh, subdomain_data=case.facets)
    options = {
        "nothing": {},
        "springs": {"potential": 0.5 * k * ufl.inner(case.u, case.u) * ds(TOP)},
        "modulus": {"law": dm.Elastic(E, 0.3)},
    }[what]
    problem = case.problem(petsc_options=SOLVERS[solver], **options)
    forces = []
    for step in range(3):
        k.value = E.value = 1.0 + 100.0 * step
        dm.newton(problem, rtol=1e-10)
        problem.commit()
        forces.append(problem.contacts[0].force[1] / (E.value if what == "modulus" else 1.0))
    assert len(calls) == (1 if what == "nothing" else 3)
    assert forces == pytest.approx([forces[0]] * 3, rel=1e-9)


def test_both_forms_are_one_program():
    """T^T K T formed, and applied: products and right-hand side."""
    found = []
    for options in SOLVERS.values():
        case = PressedBlocks()
        problem = case.problem(petsc_options=options)
        data = problem.begin_step()
        case.u.interpolate(lambda x: 1e-3 * np.sin(np.stack([x[0], x[0] + 1.0])))
        problem.update_geometry()
        lin = linearise(problem, find_balance(problem, data))
        x = problem.vector(np.cos(problem.X))
        vectors = [v.array.copy() for v in (lin.qp.A * x, lin.qp.b)]  # these outlive the mesh
        for values in vectors:
            values[lin.balance.eliminated] = 0.0
        found.append((vectors, (lin.diagonal.array.copy(), lin.qp.A.getDiagonal().array.copy())))
    for close, pairs in zip((1e-12, 1e-3), zip(*found, strict=True), strict=True):
        for formed, applied in zip(*pairs, strict=True):
            assert formed.any()
            assert np.abs(formed - applied).max() < close * np.abs(formed).max()


class OwnSpring(dm.Term):
    """A term of a user's that may add whole matrices."""

    has_tangent = True

    def add_forces(self, F):
        """Add nothing at rest."""

    def add_tangent(self, K):
        """Add a matrix of its own, in AIJ."""
        K.assemble()
        K.axpy(1.0, PETSc.Mat().createConstantDiagonal(K.getSizes(), 1e-9, K.comm).convert("aij"))


@pytest.mark.parametrize(
    ("solver", "terms", "blocks"),
    [("iterative", [], True), ("direct", [], False), ("iterative", [OwnSpring()], False)],
)
def test_the_tangent_is_stored_in_blocks(solver, terms, blocks):
    """Where nobody multiplies it with a matrix or adds one."""
    problem = PressedBlocks().problem(petsc_options=SOLVERS[solver], terms=terms)
    assert ("baij" in problem.K.getType()) == blocks
    dm.newton(problem)
    assert problem.linear.direct == (solver == "direct")
