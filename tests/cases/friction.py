# SPDX-License-Identifier: MIT
"""A small block on a larger one, pressed and pushed by its top, in 2D and in 3D, turned at will."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

import dolfinx_mortar as dm
from dolfinx import fem
from dolfinx.mesh import MeshTags
from tests.cases import meshes, meshes_3d
from tests.cases.mortar import largest
from tests.cases.two_bodies import COMM, TwoBodies, create_problem

__all__ = ["COMM", "largest"]

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


ALIKE = {  # blocks that are as wide as each other
    2: {"x_lower": (0.0, 1.0), "n_lower": (5, 2), "n_upper": (4, 3), "jitter": 0.3},
    3: {"lower": (0.0, 1.0, 0.0, 1.0), "n_lower": (3, 3, 2), "n_upper": (2, 4, 2), "jitter": 0.3},
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
        problem = create_problem(old.V, [contact], self.bcs, ELASTIC, geometry=old.geometry)
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
        size = SPACE | {"turn": turn}
    else:
        turn = meshes_3d.rotation((0.0, 0.0, 1.0), angle)[:2, :2]
        size = PLANE | {"angle": angle}
    case = TwoBodies(cell, degree, **size | (mesh_options or {}))
    bcs, contact = case.bcs(), case.interface(swap=slave != "lower", surface=surface, **options)
    given = {"geometry": geometry, "petsc_options": petsc_options}
    problem = case.problem([contact], bcs, law, **given)
    return PushedBlock(problem, contact, bcs, case.cells, case.top, turn)


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
