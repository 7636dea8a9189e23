# SPDX-License-Identifier: MIT
"""Every number of the steps and interfaces, halved and doubled: the answer stays the same."""

import ast
import importlib
from pathlib import Path

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_mortar as dm
from dolfinx import fem
from tests.hertz_case import PLASTIC, create_case

COMM = MPI.COMM_WORLD
PACKAGE = Path(dm.__file__).parent
NUMBERS = {
    "interfaces.near": ("INCREMENT_SHARE", "FACETS", "ROOM", "OVERLAP", "SAME_DEPTH"),
    "steps.audit": ("COARSE", "BACK", "DEEP", "ROUND_OFF", "EXACT"),
    "steps.bodies": ("HELD", "SAME"),
    "steps.failures": ("FLOWING", "SOFT"),
    "steps.line_search": ("ARMIJO", "MAX_HALVINGS"),
    "steps.forcing": ("FORCING", "FIRST_QP", "QP_SHARE"),
    "steps.newton": ("FARTHEST",),
    "steps.watch": ("MOST_RISES",),
    "steps.residuals": ("EPS", "ROW_SUM", "GAP_OPERATIONS", "FIRST_SHARE"),
}
OTHERS = {"steps.mesh_audit", "interfaces.contact"}  # judged in test_mesh_audit, and below


def numbers_in(file):
    """Return the names of the numbers that a module defines."""
    found = []
    for node in ast.parse(file.read_text()).body:
        targets = node.targets if isinstance(node, ast.Assign) else [getattr(node, "target", None)]
        value = getattr(node, "value", None)
        if value is None or not isinstance(node, ast.Assign | ast.AnnAssign):
            continue
        has_number = any(
            isinstance(part, ast.Constant) and type(part.value) in (int, float)
            for part in ast.walk(value)
        ) or "finfo" in ast.dump(value)
        names = [n.id for target in targets for n in ast.walk(target) if isinstance(n, ast.Name)]
        found += [name for name in names if has_number and name.isupper()]
    return found


def test_no_number_is_left_out():
    for floor in ("steps", "interfaces"):
        for file in sorted((PACKAGE / floor).glob("*.py")):
            module = f"{floor}.{file.stem}"
            if module not in OTHERS:
                assert set(numbers_in(file)) == set(NUMBERS.get(module, ())), module


def observe():
    """Return what a user would look at: an audit and two plastic steps, the second with sliding."""
    case = create_case(dm.meshing.hertz(COMM, kind="graded", h=0.6), PLASTIC, slave="disc")
    numbers = [len(case.problem.audit().warnings)]
    for x, depth in ((0.0, 0.2), (0.3, 0.25)):
        case.top.value[:] = (x, -depth)
        dm.newton(case.problem, rtol=1e-10)
        case.problem.commit()
        numbers += [case.force, *case.contact.moment, case.problem.solid.max("von_mises")]
    return np.array(numbers)


@pytest.fixture(scope="module")
def usual():
    return observe()


@pytest.mark.parametrize("factor", [0.5, 2.0])
@pytest.mark.parametrize(
    ("module", "name"), [(module, name) for module, names in NUMBERS.items() for name in names]
)
def test_half_and_double(module, name, factor, usual, monkeypatch):
    where = importlib.import_module(f"dolfinx_mortar.{module}")
    value = getattr(where, name)
    if isinstance(value, dict):
        changed = {key: factor * number for key, number in value.items()}
    else:
        changed = type(value)(factor * value)
    monkeypatch.setattr(where, name, changed)
    assert observe() == pytest.approx(usual, rel=1e-8, abs=1e-6)


# -- the one number that is a decision -------------------------------------------------------------


@pytest.mark.parametrize(("degrees", "kept"), [(5, True), (50, True), (70, False)])
def test_a_normal_that_dirichlet_data_take(degrees, kept):
    """A slave normal keeps its contact while at least half of it, 60 degrees, is left free."""
    length = np.cos(np.radians(degrees))
    contact = dm.Contact.__new__(dm.Contact)
    assert bool(contact.may_carry(np.array([length]), np.zeros((1, 2), dtype=bool))[0, 0]) == kept


@pytest.mark.mpi
def test_a_tilted_normal_in_a_symmetry_plane():
    """Arc nodes with prescribed u_x and a normal tilted by some degrees still carry pressure.

    Their normals are straightened, not dropped; so it is at the end of a half model, where the
    averaged normal has no neighbour beyond the plane.
    """
    mesh, _, tags = dm.meshing.hertz(COMM, kind="paper")
    V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
    x = V.tabulate_dof_coordinates()
    arc = fem.locate_dofs_topological(V.sub(0), 1, tags.find(4))
    tilted = arc[(np.abs(x[arc // 2, 0]) > 0.3) & (np.abs(x[arc // 2, 0]) < 1.5)]
    held = [fem.locate_dofs_topological(V, 1, tags.find(t)) for t in (1, 2)]
    bcs = [fem.dirichletbc(np.array([0.0, -d]), n, V) for d, n in zip((0, 0.1), held, strict=True)]
    bcs.append(fem.dirichletbc(fem.Constant(mesh, 0.0), tilted, V.sub(0)))
    contact = dm.Contact(tags, slave=4, master=3)
    problem = dm.ContactProblem(dm.Solid(fem.Function(V), dm.Elastic(1.0, 0.3)), [contact], bcs=bcs)
    problem.audit()
    (link,) = problem.system.links
    fixed = problem.fixed[link.nodes].any(axis=1) & (x[link.nodes, 1] < 0.3)
    assert COMM.allreduce(int(fixed.sum())) >= 4
    assert link.coupling.kept[fixed].all()
    normals = link.coupling.normals[fixed]
    assert np.abs(normals[:, 0]).max(initial=0.0) == 0.0  # straightened
