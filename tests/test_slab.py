# SPDX-License-Identifier: MIT
"""A slice of one element with held faces is plane strain: 3D against 2D on the same section."""

from mpi4py import MPI

import numpy as np
import pytest
from scipy.spatial import cKDTree

import basix.ufl
import dolfinx
import dolfinx_mortar as dm
from dolfinx import fem
from dolfinx_mortar import compat
from dolfinx_mortar.geometry import segments
from dolfinx_mortar.geometry.facets import facet_normals
from tests.cases.hertz import ELASTIC, PLASTIC, create_mesh
from tests.choice import quick

pytestmark = pytest.mark.serial
THICKNESS, GAP = 0.3, 1e-3  # no two nodes of a section in one place
DEPTH = {ELASTIC: 0.05, PLASTIC: 0.2}


def extrude(section):
    """Return the slab of one layer of cells on a section, with its facet tags."""
    mesh = section.mesh
    x, cells = mesh.geometry.x.copy(), compat.cell_nodes(mesh).astype(np.int64)
    top = len(x)
    points = np.concatenate([x, x + np.array([0.0, 0.0, THICKNESS])])
    if mesh.topology.cell_name() == "quadrilateral":
        cell, cells = "hexahedron", np.hstack([cells, cells + top])
    else:  # prisms in three parts; ascending nodes make neighbours agree on the diagonals
        a, b, c = np.sort(cells, axis=1).T
        parts = [(a, b, c, c + top), (a, b, b + top, c + top), (a, a + top, b + top, c + top)]
        cell, cells = "tetrahedron", np.concatenate([np.column_stack(part) for part in parts])
    element = basix.ufl.element("Lagrange", cell, 1, shape=(3,))
    slab = dolfinx.mesh.create_mesh(MPI.COMM_SELF, cells, x=points, e=element)
    slab.topology.create_connectivity(2, 3)
    facets = dolfinx.mesh.exterior_facet_indices(slab.topology)
    slab.topology.create_connectivity(2, 0)
    corners = slab.geometry.x[dolfinx.mesh.entities_to_geometry(slab, 2, facets), :2]
    middle = (corners.min(axis=1) + corners.max(axis=1)) / 2
    tagged = dolfinx.mesh.compute_midpoints(mesh, 1, section.facet_tags.indices)[:, :2]
    away, nearest = cKDTree(tagged).query(middle)
    side = away < 1e-9  # the slab's ends have theirs inside the section
    values = section.facet_tags.values[nearest[side]]
    order = np.argsort(facets[side])
    return slab, dolfinx.mesh.meshtags(slab, 2, facets[side][order], values[order])


def press(mesh, facet_tags, law, slave, geometry):
    """Return force per thickness, and the displacement (n, 2) with its points."""
    d = mesh.topology.dim
    V = fem.functionspace(mesh, ("Lagrange", 1, (d,)))
    bcs = []
    for tag, y in ((1, 0.0), (2, -DEPTH[law])):
        dofs = fem.locate_dofs_topological(V, d - 1, facet_tags.find(tag))
        bcs.append(fem.dirichletbc(np.array([0.0, y, 0.0][:d]), dofs, V))
    if d == 3:
        W = V.sub(2).collapse()[0]
        everywhere = fem.locate_dofs_geometrical((V.sub(2), W), lambda x: np.isfinite(x[0]))
        bcs.append(fem.dirichletbc(fem.Function(W), everywhere, V.sub(2)))
    slave, master = {"block": (3, 4), "disc": (4, 3)}[slave]
    contact = dm.Contact(facet_tags, slave=slave, master=master)
    u = fem.Function(V)
    problem = dm.ContactProblem(
        dm.Solid(u, law),
        [contact],
        bcs=bcs,
        geometry=geometry,
        petsc_options={"pc_type": "cholesky", "pc_factor_mat_solver_type": "mumps"},
    )
    dm.newton(problem, rtol=1e-11)
    scale = THICKNESS if d == 3 else 1.0
    return contact.force[:2] / scale, V.tabulate_dof_coordinates(), u.x.array.reshape(-1, d)[:, :2]


def compare(section, law, slave, geometry="reference"):
    """Return the relative differences in force and displacement."""
    force, x, u = press(section.mesh, section.facet_tags, law, slave, geometry)
    slab_force, X, U = press(*extrude(section), law, slave, geometry)
    nearest = cKDTree(x[:, :2]).query(X[:, :2])[1]
    return (
        np.abs(slab_force - force).max() / np.abs(force).max(),
        np.abs(U - u[nearest]).max() / np.abs(u).max(),
    )


def project_along_facet_normals(slave, n_s):
    """Return the directions of 3D in 2D, too."""
    count = slave.element.nodes if slave.x.shape[2] == 2 else 1
    return np.repeat(facet_normals(slave)[:, None], count, axis=1)


@pytest.mark.parametrize("slave", quick(["block", "disc"], "block"))
@pytest.mark.parametrize("law", [ELASTIC, PLASTIC], ids=["elastic", "plastic"])
def test_hexahedra_are_quadrilaterals(law, slave, monkeypatch):
    """With one and the same direction of projection nothing else tells 3D from 2D."""
    section = create_mesh("graded", 0.3, cell="quadrilateral", gap=GAP)
    monkeypatch.setattr(segments, "projection_directions", project_along_facet_normals)
    difference = compare(section, law, slave)
    print(f"force {difference[0]:.1e}, displacement {difference[1]:.1e}")
    assert max(difference) < 1e-10
