# SPDX-License-Identifier: MIT
"""Meshes with named sets, as decks describe them."""

from collections.abc import Mapping
from typing import Any, NamedTuple

from mpi4py import MPI

import numpy as np

import basix
import basix.ufl
from dolfinx import fem
from dolfinx import mesh as dmesh
from dolfinx.cpp.io import perm_vtk
from dolfinx_mortar.algebra.parallel import named
from dolfinx_mortar.common import compat
from dolfinx_mortar.common.arrays import HALF_OF_DIGITS, Floats, Ints, Longs
from dolfinx_mortar.common.tags import Tags
from dolfinx_mortar.interfaces.contact import Contact
from dolfinx_mortar.interfaces.tie import Tie
from dolfinx_mortar.meshing.full_cells import full_cells, missing_nodes


class Kind(NamedTuple):
    """Kind of the elements of a deck."""

    name: str
    kinematics: str
    cell: str
    degree: int
    size: int  # number of nodes of an element, in the order of VTK

    def nodes(self) -> tuple[Any, Ints]:
        """Element of the full cell, and where its nodes are in the order of VTK."""
        shape = (3,) if self.kinematics == "spatial" else (2,)
        variant = basix.LagrangeVariant.equispaced
        element = basix.ufl.element(
            "P", self.cell, self.degree, lagrange_variant=variant, shape=shape
        )
        kind, count = dmesh.CellType[self.cell], element.basix_element.dim
        return element, np.array(perm_vtk(kind, count), dtype=np.int32)

    def corners(self) -> Ints:
        """Corners (facets, k) of basix's facets, in the order of VTK."""
        element, order = self.nodes()
        return order[np.array(basix.topology(element.cell_type)[-2])]


CELLS = {  # nodes of elements of both degrees; facets of basix's cell that are called S1, S2 ..
    "triangle": ((3, 6), (2, 0, 1)),
    "quadrilateral": ((4, 8), (0, 2, 3, 1)),
    "tetrahedron": ((4, 10), (3, 2, 0, 1)),
    "hexahedron": ((8, 20), (0, 5, 1, 3, 4, 2)),
}
KINEMATICS = {"C3D": "spatial", "CPE": "plane_strain", "CPS": "plane_stress", "CAX": "axisymmetric"}
TYPES = {
    f"{family}{count}": Kind(f"{family}{count}", kinematics, cell, degree, count)
    for family, kinematics in KINEMATICS.items()
    for cell, (counts, _) in CELLS.items()
    if cell.endswith("hedron") == (family == "C3D")
    for degree, count in enumerate(counts, 1)
}


def find_name(known: Mapping[str, Any], name: str, sort: str) -> Any:
    """What has a name, or a ValueError that lists the names."""
    if name not in known:
        raise ValueError(f"there is no {sort} {name!r}; known are {', '.join([*known][:20])}")
    return known[name]


class Deck:
    """What a deck describes, see `read_inp`.

    Attributes:
        mesh: all bodies.
        cell_tags: bodies, under the names of the element sets of their sections.
        kinematics: for `Solid`.
        materials: law of a body, where the deck gives one that exists here.
        densities: mass per volume of a body, where given.
        expansions: thermal expansion of a body per degree, where given.
        interfaces: a `Tie` for each TIE, a `Contact` for each CONTACT PAIR, slave side first.
        surfaces: facets of this rank by name.
        nodes: nodes of the geometry of this rank by name of a node set.
        unread: keywords that were not read, with file and line.
    """

    def __init__(self, comm: MPI.Intracomm, name: str, read: Any) -> None:
        """Distribute what rank 0 has read, None elsewhere; collective."""
        told, cells, x = read or (None, np.empty(0, dtype=np.int64), np.empty(0))
        kind, owner, bodies, surfaces, nodes, joints, self.unread = comm.bcast(told)
        self.kinematics: str = kind.kinematics
        element, order = kind.nodes()
        dim = element.block_size
        cells, x = cells.reshape(-1, len(order)), np.ascontiguousarray(x.reshape(-1, dim))
        self.mesh = domain = dmesh.create_mesh(comm, cells=cells, e=element, x=x)
        domain.name, topology = name, domain.topology
        original = topology.original_cell_index
        every = np.arange(len(original), dtype=np.int32)
        tags = dmesh.meshtags(domain, dim, every, owner[original] + 1)
        self.cell_tags = Tags(tags, {body: i for i, body in enumerate(bodies, 1)})
        self.cell_tags.name = "bodies"
        self.materials, self.densities, self.expansions = (
            {body: own[what] for body, own in bodies.items() if own.get(what) is not None}
            for what in ("law", "DENSITY", "EXPANSION")
        )
        topology.create_entities(dim - 1)
        topology.create_connectivity(dim - 1, dim)
        exterior = dmesh.exterior_facet_indices(topology)
        _, faces = CELLS[kind.cell]
        facets = topology.connectivity(dim, dim - 1).array.reshape(-1, len(faces))
        self.surfaces: dict[str, Ints] = {}
        for surface, rows in surfaces.items():
            marked = np.zeros((len(owner), len(faces)), dtype=bool)
            marked[tuple(rows.T)] = True
            self.surfaces[surface] = np.intersect1d(facets[marked[original]], exterior)
        number = domain.geometry.input_global_indices
        self.nodes = {name: np.flatnonzero(np.isin(number, rows)) for name, rows in nodes.items()}
        self.interfaces: list[Contact | Tie] = []
        for joint, place, given in joints:
            with named(place):
                tags = self.tags(*dict.fromkeys([given["slave"], given["master"]]))
                self.interfaces.append(joint(tags, **given))

    def tags(self, *names: str) -> Tags:
        """Tags 1, 2 .. of these surfaces, by default all; collective.

        Raises:
            ValueError: for unknown names, surfaces without a facet, and two with a common one.
        """
        dim = self.mesh.topology.dim - 1
        values = np.zeros(self.mesh.topology.index_map(dim).size_local, dtype=np.int32)
        names = names or (*self.surfaces,)
        for i, name in enumerate(names, 1):
            facets = find_name(self.surfaces, name, "SURFACE")
            counts = np.array([len(facets), np.count_nonzero(values[facets])])
            some, shared = self.mesh.comm.allreduce(counts)
            if not some:
                raise ValueError(f"the surface {name!r} has no facet on the boundary of a body")
            if shared:
                raise ValueError(
                    f"the surface {name!r} has facets of one before it, among {', '.join(names)}, "
                    "but a facet has one tag: take it into tags of its own"
                )
            values[facets] = i
        marked = np.flatnonzero(values).astype(np.int32)
        tags = dmesh.meshtags(self.mesh, dim, marked, values[marked])
        tags.name = "boundary"
        return Tags(tags, {name: i for i, name in enumerate(names, 1)})

    def dofs(self, V: fem.FunctionSpace, name: str) -> Ints:
        """Dofs (blocks) of a node set, for ``fem.dirichletbc``.

        Args:
            V: Lagrange space on this mesh, of a degree up to that of the cells.
            name: of an NSET.

        Raises:
            ValueError: for unknown names, and spaces that do not fit.
        """
        nodes = find_name(self.nodes, name, "NSET")
        cells, every = compat.cell_nodes(self.mesh), np.asarray(V.dofmap.list)
        if V.mesh is not self.mesh or every.shape[1] > cells.shape[1]:
            raise ValueError(f"V is {V!r}: give a Lagrange space on the mesh of the deck")
        return np.unique(every[np.isin(cells[:, : every.shape[1]], nodes)]).astype(np.int32)


def complete(
    kind: Kind, cells: Longs, x: Floats, sets: Mapping[str, list[int]]
) -> tuple[Longs, Floats, dict[str, Longs]]:
    """Full cells (m, K) in basix's order, their nodes (n, d), and those of sets that have some.

    A node that is added is in a set if all of those are that it is computed from.
    """
    element, order = kind.nodes()
    dim = element.block_size
    weights = missing_nodes(kind.cell, element.basix_element.points[np.argsort(order)], kind.size)
    used, rows = np.unique(cells, return_inverse=True)
    x, rows = x[used], rows.reshape(cells.shape)
    if np.abs(x[:, dim:]).max(initial=0.0) > HALF_OF_DIGITS * np.ptp(x):
        raise ValueError(f"elements {kind.name} are in the plane z = 0, but not all of their nodes")
    x, (full,) = full_cells(x[:, :dim], (weights, rows))
    sources = np.vstack([np.eye(kind.size), weights != 0.0])
    found = {}
    for name, nodes in sets.items():
        inside = np.isin(used, nodes)[rows] @ sources.T == sources.sum(axis=1)
        if inside.any():
            found[name] = np.unique(full[inside])
    return full[:, order], x, found
