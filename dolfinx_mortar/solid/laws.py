# SPDX-License-Identifier: MIT
"""Which law holds in which cells: the user's tags turned into one region per law."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any, TypeVar

import numpy as np

import ufl
from dolfinx import fem, mesh
from dolfinx_mortar.algebra.errors import raised_together
from dolfinx_mortar.arguments import check
from dolfinx_mortar.arrays import Floats, Ints, Longs
from dolfinx_mortar.materials import Material
from dolfinx_mortar.materials.protocol import RESERVED, Law, create_law
from dolfinx_mortar.materials.ranges import named_parameters
from dolfinx_mortar.solid.kinematics import Kinematics
from dolfinx_mortar.solid.parameters import ParameterTable
from dolfinx_mortar.tags import by_tag, check_entities, labels, tags_of

T = TypeVar("T")

UNTAGGED = int(np.iinfo(np.int32).min)


@dataclass(frozen=True)
class Region:
    """The cells of one law, whatever the values of its parameters."""

    law: Law
    cells: np.ndarray  # int32 (m,), local cells, ghosts included
    parameters: ParameterTable
    parts: tuple[tuple[Any, Ints], ...] = ()  # the materials, each with its own of these cells

    @property
    def symbols(self) -> SimpleNamespace:
        """The parameters by name, as UFL."""
        return self.parameters.symbols

    def output(self, state: Mapping[str, Floats], cells: Ints, points: int) -> dict[str, Floats]:
        """Return the law's own fields, (q,) or (q, components), q points cell by cell.

        The state has the same shapes; `points` is the number of points per cell.

        Raises:
            ValueError: if the law raises or returns something wrong; the message names it.
        """
        if self.law.output is None:
            return {}
        where, q = f"{self.law.name}.output", len(cells) * points
        try:
            found = self.law.output(state, self.parameters.values(cells, points))
            fields = {name: np.asarray(f, dtype=float) for name, f in dict(found or {}).items()}
        except Exception as error:
            raise ValueError(
                f"{where} raised {type(error).__name__}: {error} (at {q} integration points)"
            ) from error
        for name, field in fields.items():
            if not isinstance(name, str) or name in (*RESERVED, *self.law.state):
                raise ValueError(f"{where} returns the name {name!r}: it is taken, or no text.")
            if field.ndim not in (1, 2) or len(field) != q:
                raise ValueError(
                    f"{where}: {name} has the shape {field.shape} at {q} integration points; it "
                    f"must be ({q},) or ({q}, components)."
                )
        return fields


def create_regions(
    u: fem.Function,
    materials: Material | Mapping[int | str, Material],
    cell_tags: mesh.MeshTags | None,
    degree: int,
    kinematics: Kinematics,
) -> list[Region]:
    """Group the cells by law and store the parameters; collective.

    Raises:
        ValueError: if a law lacks a part, tags and materials do not cover the cells
            exactly, or a parameter is out of its range, belongs to another mesh or depends on u.
    """
    how = kinematics.plane_stress
    given, choice = _material_of_cells(u.function_space.mesh, materials, cell_tags, how)
    for _, law in given:
        if law.strain == "finite" and not kinematics.finite:
            raise ValueError(
                f"materials: {law.name} is a law of the deformation gradient: choose "
                "Solid(.., strain='finite')"
            )
    # Those of one class, state, form at finite strain and way to plane stress are one region.
    # Sorted by name so that the same laws make the same forms in any order of the dictionary.
    alike: dict[Any, list[int]] = {}
    for i, (material, law) in enumerate(given):
        form = kinematics.finite and law.isotropic  # see `materials.logarithmic`
        names = tuple(named_parameters(material))  # of tuples some have more
        way = form, law.normal_strain is None, names
        alike.setdefault((type(material), way, *law.state), []).append(i)
    regions = []
    for kind in sorted(alike, key=lambda kind: (kind[0].__qualname__, kind[2:], kind[1])):
        chosen = alike[kind]
        law = given[chosen[0]][1]
        own = [given[i][0] for i in chosen]
        cells = [np.flatnonzero(choice == i).astype(np.int32) for i in chosen]
        table = ParameterTable(u, law, own, cells, degree)
        table.follow()
        every = np.sort(np.concatenate(cells))
        regions.append(Region(law, every, table, tuple(zip(own, cells, strict=True))))
    return regions


def _material_of_cells(
    domain: mesh.Mesh,
    materials: Material | Mapping[int | str, Material],
    cell_tags: mesh.MeshTags | None,
    plane_stress: bool,
) -> tuple[list[tuple[Any, Law]], np.ndarray]:
    """Return materials with their laws and, per local cell, ghosts included, which of them it has.

    Collective.
    """
    imap = domain.topology.index_map(domain.topology.dim)
    count = imap.size_local + imap.num_ghosts
    if not isinstance(materials, Mapping):
        law = create_law("materials", materials, plane_stress=plane_stress)
        return [(materials, law)], np.zeros(count, dtype=np.int32)
    laws = {
        tag: (law, create_law(f"materials[{tag!r}]", law, plane_stress=plane_stress))
        for tag, law in materials.items()
    }
    given, values = by_cells(domain, cell_tags, laws, "materials", cover=True)
    tags = sorted(given)
    return [given[tag] for tag in tags], np.searchsorted(tags, values).astype(np.int32)


def by_cells(
    domain: mesh.Mesh, cell_tags: Any, given: Mapping[Any, T], name: str, *, cover: bool = False
) -> tuple[dict[int, T], Longs]:
    """Return the entries of an argument by tag, and the tags of the local cells; collective.

    Args:
        domain: the mesh.
        cell_tags: of its cells.
        given: entries by tag or by name.
        name: of the argument, for messages.
        cover: whether each cell has to have an entry.

    Raises:
        ValueError: on all ranks, for tags of no cell, and cells without an entry.
    """
    if not given or cell_tags is None:
        raise ValueError(f"{name} is a dictionary by cell tag: give an entry, and cell_tags")
    values = tags_of_cells(domain, cell_tags)
    found = by_tag(cell_tags, given, name)
    own = values[: domain.topology.index_map(domain.topology.dim).size_local]
    cells: Counter[int] = sum(domain.comm.allgather(Counter(map(int, own))), Counter())
    tagged, lost = cells.keys() - {UNTAGGED}, found.keys() - cells.keys()
    missing = cells.keys() - found.keys() if cover else set()
    if missing and not (tagged and lost):
        count = sum(cells[tag] for tag in missing)
        told = labels(cell_tags, sorted(missing)).replace(str(UNTAGGED), "none")
        raise ValueError(
            f"{name} has no entry for {count} cells of the tags {told}: add one for each, and tag "
            "all cells"
        )
    if lost:
        there, told = labels(cell_tags, sorted(tagged)), labels(cell_tags, sorted(lost, key=str))
        raise ValueError(f"{name}: no cell has the tag {told}; cell_tags has {there}")
    return found, values


def tags_of_cells(domain: mesh.Mesh, cell_tags: mesh.MeshTags) -> Longs:
    """Return the tags of the local cells, ghosts included, UNTAGGED without one; collective.

    Raises:
        ValueError: on all ranks, if the tags are not those of the cells of the mesh.
    """
    check("cell_tags", cell_tags, tags_of(domain, domain.topology.dim))
    with raised_together(domain.comm):
        check_entities("cell_tags", cell_tags)
    imap = domain.topology.index_map(domain.topology.dim)
    # Through a DG0 Function, so that ghost cells get their owner's tag.
    marker = fem.Function(fem.functionspace(domain, ("DG", 0)))
    dofs = marker.function_space.dofmap.list[:, 0]
    marker.x.array[:] = float(UNTAGGED)
    marker.x.array[dofs[cell_tags.indices]] = cell_tags.values
    marker.x.scatter_forward()
    return np.asarray(marker.x.array[dofs[: imap.size_local + imap.num_ghosts]].astype(np.int64))


def measure(domain: mesh.Mesh, degree: int) -> ufl.Measure:
    """Return the measure of all cells, by the quadrature of a solid."""
    metadata = {"quadrature_degree": degree, "quadrature_scheme": "default"}
    return ufl.Measure("dx", domain, metadata=metadata)


def measures(V: fem.FunctionSpace, regions: Sequence[Region], degree: int) -> list[ufl.Measure]:
    """Return the measure of the cells of each region."""
    dx = measure(V.mesh, degree)
    if len(regions) == 1:
        return [dx]
    owned = V.mesh.topology.index_map(V.mesh.topology.dim).size_local
    # Numbers of the laws, not the user's tags: tags must not enter the compiled code.
    dx = dx(subdomain_data=[(i, r.cells[r.cells < owned]) for i, r in enumerate(regions)])
    return [dx(i) for i in range(len(regions))]
