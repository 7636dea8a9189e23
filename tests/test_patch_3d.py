# SPDX-License-Identifier: MIT
"""Contact patch tests in 3D: a constant stress state across a non-matching interface."""

from petsc4py import PETSc

import numpy as np
import pytest

import basix
import dolfinx.fem.petsc
import dolfinx_mortar as dm
import ufl
from dolfinx import default_scalar_type, fem
from dolfinx_mortar.mortar.surface import accumulate, create_surface
from tests.cases.meshes_3d import (
    BOTTOM,
    BOTTOM_OF_UPPER,
    FRONT,
    LEFT,
    TOP,
    TOP_OF_LOWER,
    rotation,
)
from tests.cases.two_bodies import TwoBodies
from tests.test_patch import NU, E, P, check

STRAIN = np.diag([NU / E * P, NU / E * P, -P / E])  # of the uniaxial stress -P along z
TILTED = rotation((1.0, 2.0, 0.5), 0.7)


def clip(polygon, rectangle):
    for i, bound, sign in ((0, 0, 1), (0, 1, -1), (1, 2, 1), (1, 3, -1)):
        d = sign * (polygon[:, i] - rectangle[bound])
        points = []
        for a in range(len(polygon)):
            b = (a + 1) % len(polygon)
            if d[a] >= 0:
                points.append(polygon[a])
            if d[a] * d[b] < 0:
                points.append(polygon[a] + d[a] / (d[a] - d[b]) * (polygon[b] - polygon[a]))
        polygon = np.array(points).reshape(-1, 2)
        if len(polygon) < 3:
            return polygon[:0]
    return polygon


def covered_integrals(element, x, rectangle):
    """Return the integrals (k,) of N_j over the part of a triangle or rectangle x in another."""
    corners = x[list(element.vertices)]
    edges = (corners[[1, -1]] - corners[0]).T
    if element.bilinear:
        assert np.isclose(corners[2], corners[1] + corners[3] - corners[0], atol=1e-13).all()
    result = np.zeros(len(x))
    part = clip(corners, rectangle)
    r, weights = basix.make_quadrature(basix.CellType.triangle, 4)
    for b in range(1, len(part) - 1):
        sides = (part[[b, b + 1]] - part[0]).T
        xi = np.linalg.solve(edges, sides @ r.T + (part[0] - corners[0])[:, None]).T
        N = element.shape_functions(2 * xi - 1 if element.bilinear else xi)
        result += abs(np.linalg.det(sides)) * weights @ N
    return result


def uncovered_pressure(V, facets, tag, R, rectangle):
    """Return a Function p so that int p N_j over a side is int N_j over its uncovered part."""
    surface = create_surface(V, facets, tag, "slave")
    x = (surface.X @ R)[surface.facets][:, :, :2]
    local = np.zeros(len(surface.nodes))
    for nodes, corners in zip(surface.facets, x, strict=True):
        everything = (-9.0, 9.0, -9.0, 9.0)
        whole, part = (
            covered_integrals(surface.element, corners, window)
            for window in (everything, rectangle)
        )
        local[nodes] += whole - part
    total = accumulate(surface, local)
    Q = V.sub(0).collapse()[0]
    p, q = ufl.TrialFunction(Q), ufl.TestFunction(Q)
    ds = ufl.Measure("ds", V.mesh, subdomain_data=facets)(tag)
    result, right = fem.Function(Q), fem.Function(Q)
    A = dolfinx.fem.petsc.assemble_matrix(
        fem.form(p * q * ds + fem.Constant(V.mesh, default_scalar_type(0)) * p * q * ufl.dx)
    )
    A.assemble()
    right.x.array[surface.nodes] = total
    right.x.scatter_forward()
    index_map = Q.dofmap.index_map
    off = np.ones(index_map.size_local, dtype=bool)
    off[surface.nodes[: surface.owned]] = False
    rows = (index_map.local_range[0] + np.flatnonzero(off)).astype(PETSc.IntType)
    A.zeroRowsColumns(rows, 1.0)
    solver = PETSc.KSP().create(V.mesh.comm)
    solver.setOperators(A)
    solver.setType("preonly")
    solver.getPC().setType("lu")
    solver.getPC().setFactorSolverType("mumps")
    solver.solve(right.x.petsc_vec, result.x.petsc_vec)
    result.x.scatter_forward()
    return result


def solve_patch(
    slave="lower", *, cell="tetrahedron", turn=None, hold="planes", degree=1, **options
):
    """Press the upper box on the lower one; return problem, contact and the exact solution."""
    R = np.eye(3) if turn is None else turn
    case = TwoBodies(cell, degree, turn=turn, **options)
    mesh, V, exact, strain = case.mesh, case.V, fem.Function(case.V), R @ STRAIN @ R.T
    exact.interpolate(lambda x: strain @ x[:3])
    n = fem.Constant(mesh, R[:, 2].astype(default_scalar_type))
    v, ds = ufl.TestFunction(V), ufl.Measure("ds", mesh, subdomain_data=case.facets)
    if hold == "planes":
        bcs = [case.held(LEFT, 0.0, 0), case.held(FRONT, 0.0, 1), case.held(BOTTOM, P / E, 2)]
    else:
        edge = fem.locate_dofs_geometrical(
            V, lambda x: np.isclose((R.T @ x)[0], 0) & np.isclose((R.T @ x)[2], 1)
        )
        bcs = [case.held(BOTTOM, exact), fem.dirichletbc(exact, edge)]
    loads = -P * ufl.dot(n, v) * ds(TOP)
    # Where one box sticks out beyond the other, the pressure acts on it directly.
    ends = [ends_of(options, side) for side in ("lower", "upper")]
    if ends[0] != ends[1]:
        for tag, sign, other in ((TOP_OF_LOWER, 1, ends[1]), (BOTTOM_OF_UPPER, -1, ends[0])):
            free = uncovered_pressure(V, case.facets, tag, R, other)
            loads += -sign * P * free * ufl.dot(n, v) * ds(tag)
    contact = case.interface(swap=slave == "upper")
    rest = {"loads": loads, "geometry": "reference"}
    return case.problem([contact], bcs, dm.Elastic(E, NU), **rest), contact, exact


def ends_of(options, side):
    """Return low x, high x, low y, high y of a box."""
    splits = options.get(f"splits_{side}")
    if splits is None:
        return options.get(side, (0.0, 1.0, 0.0, 1.0))
    return splits[0][0], splits[0][-1], splits[1][0], splits[1][-1]


KINDS = [(cell, degree) for cell in ("tetrahedron", "hexahedron") for degree in (1, 2)]
CROSSED = {"lower": (0, 1.3, 0, 1), "upper": (0, 1, 0, 1.25), "turn": TILTED}


@pytest.mark.mpi
@pytest.mark.parametrize(("cell", "degree"), KINDS)
@pytest.mark.parametrize(
    ("slave", "hold", "options"),
    [
        ("lower", "planes", {}),
        ("upper", "nodes", {"turn": TILTED, "jitter": 0.4}),
        ("lower", "nodes", CROSSED),
        pytest.param("upper", "nodes", CROSSED, marks=pytest.mark.slow),
        pytest.param("upper", "planes", CROSSED | {"turn": None}, marks=pytest.mark.slow),
    ],
    ids=["planes", "inclined", "crossed", "crossed, upper", "crossed, planes"],
)
def test_pressure_is_uniform(slave, cell, degree, hold, options):
    """Symmetry planes cut through the contact, or nothing holds its edges; of any size."""
    check(*solve_patch(slave, cell=cell, degree=degree, hold=hold, **options))


@pytest.mark.parametrize(
    ("slave", "cell", "degree"), [("upper" if d == 1 else "lower", c, d) for c, d in KINDS]
)
@pytest.mark.parametrize("covered", [1e-3, pytest.param(1e-6, marks=pytest.mark.mpi)])
def test_little_coverage(slave, cell, degree, covered):
    """The last rows of facets of the slave side are covered by a small part of their length."""
    end = 1 - 0.4 * covered
    short = (np.array([0, 0.31, 0.77, 1.0]),) * 2
    long = (np.array([0, 0.35, 0.7, end, end + 0.4]), np.array([0, 0.4, end, end + 0.4]))
    lower, upper = (long, short) if slave == "lower" else (short, long)
    check(*solve_patch(slave, cell=cell, degree=degree, splits_lower=lower, splits_upper=upper))
