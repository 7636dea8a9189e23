# SPDX-License-Identifier: MIT
"""A small block on a larger one, pressed and pushed by its top, in 2D and in 3D, turned at will."""

from __future__ import annotations

from dataclasses import dataclass

from mpi4py import MPI

import numpy as np

import dolfinx_mortar as dm
from dolfinx import fem
from dolfinx.mesh import MeshTags
from tests.cases import meshes, meshes_3d

COMM = MPI.COMM_WORLD
ELASTIC = dm.Elastic(E=1000.0, nu=0.3)
PLANE = {
    "n_lower": (7, 2),
    "n_upper": (4, 2),
    "x_lower": (-0.5, 1.5),
    "x_upper": (0.0, 1.0),
}
SPACE = {
    "n_lower": (4, 4, 2),
    "n_upper": (3, 3, 2),
    "lower": (-0.5, 1.5, -0.5, 1.5),
    "upper": (0.0, 1.0, 0.0, 1.0),
}


@dataclass
class PushedBlock:
    """A problem whose upper block is moved by its top."""

    problem: dm.ContactProblem
    contact: dm.Contact
    bcs: list[fem.DirichletBC]
    cells: MeshTags
    top: fem.Constant  # displacement of the top
    turn: np.ndarray  # (d, d) how the whole is turned

    def push(self, *components: float) -> None:
        """Prescribe the displacement of the top in the blocks' own axes."""
        self.top.value[:] = self.turn @ np.array(components)

    def solve(self, *components: float, rtol: float = 1e-12) -> dm.StepReport:
        """Prescribe the displacement of the top, solve, and commit."""
        self.push(*components)
        report = dm.newton(self.problem, rtol=rtol)
        self.problem.commit()
        return report

    def again(self, interface: type = dm.Contact, **options) -> PushedBlock:
        """Return another problem on the same mesh, with another interface."""
        old = self.problem
        sides = {"slave": self.contact.slave, "master": self.contact.master}
        surface = "smooth" if self.contact.smooth else "facets"
        contact = interface(self.contact.facet_tags, **sides, surface=surface, **options)
        solid = dm.Solid(fem.Function(old.V, name="u"), ELASTIC, self.cells)
        problem = dm.ContactProblem(solid, [contact], bcs=self.bcs, geometry=old.geometry)
        return PushedBlock(problem, contact, self.bcs, self.cells, self.top, self.turn)

    def closed(self) -> dict[str, np.ndarray]:
        """Return the closed nodes of all ranks on every rank; vectors in the blocks' own axes."""
        found = self.contact.gather(self.problem.u)
        on = found["pressure"] > 0.0
        return {k: v[on] if v.ndim == 1 else v[on] @ self.turn for k, v in found.items()}

    @property
    def forces(self) -> np.ndarray:
        """Forces (d,) on the lower block, the slave or not, in the blocks' own axes."""
        lower = self.contact.slave == meshes.TOP_OF_LOWER
        return self.turn.T @ (self.contact.force if lower else self.contact.master_force)


def create(
    cell: str = "triangle",
    *,
    degree: int = 1,
    slave: str = "lower",
    angle: float = 0.0,
    law=ELASTIC,
    geometry: str = "reference",
    surface: str = "facets",
    petsc_options=None,
    mesh_options=None,
    **options,
) -> PushedBlock:
    """Return the blocks, touching; the options are those of the contact."""
    space = cell in ("tetrahedron", "hexahedron")
    if space:
        turn = meshes_3d.rotation((1.0, 2.0, 3.0), angle)
        make, size = meshes_3d.two_boxes, SPACE | {"turn": turn}
    else:
        turn = meshes_3d.rotation((0.0, 0.0, 1.0), angle)[:2, :2]
        make, size = meshes.two_blocks, PLANE | {"angle": angle}
    mesh, cells, facets = make(COMM, cell=cell, **size | (mesh_options or {}))
    d = mesh.geometry.dim
    V = fem.functionspace(mesh, ("Lagrange", degree, (d,)))
    top = fem.Constant(mesh, np.zeros(d))
    bcs = []
    for tag, value in ((meshes.BOTTOM, fem.Constant(mesh, np.zeros(d))), (meshes.TOP, top)):
        dofs = fem.locate_dofs_topological(V, d - 1, facets.find(tag))
        bcs.append(fem.dirichletbc(value, dofs, V))
    sides = (meshes.TOP_OF_LOWER, meshes.BOTTOM_OF_UPPER)
    sides = sides if slave == "lower" else sides[::-1]
    contact = dm.Contact(facets, slave=sides[0], master=sides[1], surface=surface, **options)
    solid = dm.Solid(fem.Function(V, name="u"), law, cells)
    problem = dm.ContactProblem(
        solid, [contact], bcs=bcs, geometry=geometry, petsc_options=petsc_options
    )
    return PushedBlock(problem, contact, bcs, cells, top, turn)


def largest(array) -> float:
    """Return the largest absolute value of all ranks."""
    return float(COMM.allreduce(float(np.abs(array).max(initial=0.0)), op=MPI.MAX))


def check_coulomb(case: PushedBlock, mu: float, accuracy: float = 1e-10) -> dict[str, np.ndarray]:
    """Coulomb's law at each closed node, and action and reaction; return the nodes."""
    nodes, contact = case.closed(), case.contact
    tau, p, slip = (nodes[name] for name in ("traction", "pressure", "step_slip"))
    size, way = (np.linalg.norm(v, axis=1) for v in (tau, slip))
    sticks, slides = (nodes["status"] == value for value in (1.0, 2.0))
    assert (sticks | slides).all() and len(p) > 1
    assert largest(way[sticks]) == 0.0 and (size <= mu * p + accuracy * p.max()).all()
    assert largest(size[slides] - mu * p[slides]) < accuracy * p.max()
    along = mu * p[:, None] * slip + tau * way[:, None]  # against the slip
    assert largest(along[slides]) <= accuracy * p.max() * largest(way)
    exact = case.problem.geometry == "reference"
    assert not exact or largest(tau[:, -1]) < accuracy * p.max()
    size = largest(contact.force)
    assert largest(contact.force + contact.master_force) < accuracy * size
    moment = largest(contact.moment + contact.master_moment)
    assert moment < (accuracy if exact else 1e-6) * size
    return nodes
