# SPDX-License-Identifier: MIT
"""Bodies that fold and touch themselves at finite strain: an arch of two legs, a ring, a strip."""

from collections.abc import Callable
from dataclasses import dataclass

from mpi4py import MPI

import numpy as np

import dolfinx
import dolfinx_mortar as dm
from dolfinx import fem
from tests.cases.meshes import box_cells, box_points, create_distributed
from tests.cases.two_bodies import create_problem

SKIN = 1
RUBBER = dm.NeoHooke(1.0, 0.3)


def create_sheet(
    comm: MPI.Comm,
    cells: tuple[int, ...],
    place: Callable,
    *,
    cell: str = "quadrilateral",
    closed: bool = False,
) -> tuple[dolfinx.mesh.Mesh, dolfinx.mesh.MeshTags]:
    """Return a bent sheet, and its facet tags, all with SKIN."""
    d, lines = len(cells), [np.linspace(0.0, 1.0, n + 1) for n in cells]
    s, e = box_points(lines), box_cells(cells, cell)
    if closed:
        s[:, 0] %= 1.0
        s, number = np.unique(s, axis=0, return_inverse=True)
        e = number.ravel()[e]
    x = place(s)
    mesh = create_distributed(comm, x, e, cell)
    mesh.topology.create_connectivity(d - 1, d)
    facets = np.sort(dolfinx.mesh.exterior_facet_indices(mesh.topology))
    return mesh, dolfinx.mesh.meshtags(mesh, d - 1, facets, np.full(len(facets), SKIN, np.int32))


def ring(radius: float = 1.0, thickness: float = 0.25, width: float = 0.5) -> Callable:
    """Return the places of a ring around the origin, in space with an axis along z."""

    def place(s):
        angle, r = 2 * np.pi * s[:, 0], radius + thickness * (s[:, 1] - 1.0)
        x = [r * np.cos(angle), r * np.sin(angle)]
        return np.stack([*x, *(width * s[:, 2:].T)], axis=1)

    return place


def hairpin(gap: float = 0.4, thickness: float = 0.2, leg: float = 1.5, width: float = 0.4):
    """Return the places of a strip that is bent by half a circle between two straight legs."""
    inner = gap / 2
    middle = inner + thickness / 2
    bend = np.pi * middle

    def place(s):
        along = s[:, 0] * (2 * leg + bend) - leg - bend / 2
        r = inner + thickness * s[:, 1]
        angle = np.clip(along, -bend / 2, bend / 2) / middle
        x = r * np.cos(angle) - np.maximum(np.abs(along) - bend / 2, 0.0)
        y = r * np.sin(angle)
        return np.stack([x, y, *(width * s[:, 2:].T)], axis=1)

    return place


@dataclass
class Fold:
    """A sheet whose ends or poles are brought together by supports."""

    problem: dm.ContactProblem
    contact: dm.Contact
    push: fem.Constant
    bcs: list[fem.DirichletBC]

    def close(self, way: float, **options) -> dm.StepReport:
        """Bring them nearer, by a distance in all; return the report."""
        self.push.value = -way
        report = dm.newton(self.problem, **options)
        self.problem.commit()
        return report

    @property
    def active(self) -> int:
        """Number of nodes in contact."""
        nodes = self.problem.n
        return self.problem.comm.allreduce(int(self.contact.active.x.array[:nodes].sum()))

    @property
    def reactions(self) -> tuple[np.ndarray, np.ndarray]:
        """What the supports carry, those that move and those that do not."""
        found = [dm.reaction(self.problem, bc).force for bc in self.bcs]
        return found[0] + found[2], found[1] + found[3]


def create_fold(
    sheet: tuple[dolfinx.mesh.Mesh, dolfinx.mesh.MeshTags],
    top: Callable,
    bottom: Callable,
    contact: dm.Contact | None = None,
    friction: float | None = None,
) -> Fold:
    """Return a sheet in contact with itself; its top moves down, its bottom is held."""
    mesh, tags = sheet
    d = mesh.geometry.dim
    V = fem.functionspace(mesh, ("Lagrange", 1, (d,)))
    contact = contact or dm.Contact(tags, slave=SKIN, master=SKIN, friction=friction)
    push, still = (fem.Constant(mesh, 0.0) for _ in range(2))
    places = [(top, 1, push), (bottom, 1, still), (top, 0, still), (bottom, 0, still)]
    places += [(lambda x: x[2] < 1e-9, 2, still)] if d == 3 else []
    bcs = []
    for where, component, value in places:
        facets = dolfinx.mesh.locate_entities_boundary(mesh, d - 1, where)
        dofs = fem.locate_dofs_topological(V.sub(component), d - 1, facets)
        bcs.append(fem.dirichletbc(value, dofs, V.sub(component)))
    problem = create_problem(V, [contact], bcs, RUBBER, strain="finite")
    return Fold(problem, contact, push, bcs)


def create_ring(comm=MPI.COMM_WORLD, cells=(32, 2), **options) -> Fold:
    """Return a ring that is pressed together between its poles."""
    cell = "quadrilateral" if len(cells) == 2 else "hexahedron"
    sheet = create_sheet(comm, cells, ring(), cell=cell, closed=True)
    return create_fold(sheet, lambda x: x[1] > 0.95, lambda x: x[1] < -0.95, **options)


def create_hairpin(comm=MPI.COMM_WORLD, cells=(40, 3), **options) -> Fold:
    """Return a strip that is bent by half a circle, whose ends are brought together."""
    cell = "quadrilateral" if len(cells) == 2 else "hexahedron"
    sheet = options.pop("sheet", None) or create_sheet(comm, cells, hairpin(), cell=cell)
    ends = [lambda x, s=s: (s * x[1] > 0.4 - 1e-9) & (x[0] < -1.0) for s in (1, -1)]  # outer faces
    return create_fold(sheet, *ends, **options)


def closed_ring(comm: MPI.Comm) -> np.ndarray:
    """Close a ring on itself in five steps; assert what holds; return forces, and nodes closed."""
    bar = 1e-6
    fold = create_ring(comm)
    audit = fold.problem.audit()
    assert audit.warnings == []
    assert (audit.interfaces[0].slave_facets, audit.interfaces[0].master_facets) == (0, 0)
    reports = [fold.close(way, rtol=1e-9) for way in (0.9, 1.4, 1.6)]
    assert [r.certificate.crossing for r in reports] == [0.0] * 3
    assert reports[-1].certificate.force_balance < bar
    assert reports[-1].certificate.moment_balance < bar
    force, (above, below) = fold.contact.force, fold.reactions
    assert fold.active >= 3
    assert np.abs(above + below).max() < bar * abs(above[1])
    assert abs(force[0]) < bar * abs(force[1])
    assert 0.5 < force[1] / above[1] < 1.0  # of what the poles carry, the two bends bear a little
    values = fold.contact.gather(fold.problem.u)
    on = values["pressure"] > 0.0
    x, p = values["x"][on, 0], values["pressure"][on]
    order, back = np.argsort(x), np.argsort(-x)
    assert np.abs(x[order] + x[back]).max() < bar
    assert np.abs(p[order] - p[back]).max() < bar * p.max()
    return np.array([*force, *above, fold.active])
