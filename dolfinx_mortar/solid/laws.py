# SPDX-License-Identifier: MIT
"""Which law holds in which cells: the user's tags turned into one region per law."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

from mpi4py import MPI

import numpy as np

import ufl
from dolfinx import fem, mesh
from dolfinx_mortar import compat
from dolfinx_mortar.algebra.errors import raised_together
from dolfinx_mortar.arrays import Floats, Ints, Longs
from dolfinx_mortar.materials import Material
from dolfinx_mortar.materials.protocol import RESERVED, Law, create_law
from dolfinx_mortar.materials.ranges import named_parameters
from dolfinx_mortar.solid.kinematics import Kinematics
from dolfinx_mortar.solid.parameters import ParameterTable
from dolfinx_mortar.tags import by_tag, check_entities, label, labels

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
    laws = {}
    for tag, material in materials.items():
        if not isinstance(tag, int | np.integer | str):
            raise ValueError(
                f"materials has the key {tag!r}: its keys are cell tags, integers, or their names."
            )
        law = create_law(f"materials[{tag!r}]", material, plane_stress=plane_stress)
        laws[tag] = material, law
    if not materials or cell_tags is None:
        raise ValueError(
            "materials is a dictionary by cell tag: give at least one material, and cell_tags."
        )
    given = by_tag(cell_tags, laws, "materials")
    tags = np.array(sorted(given), dtype=np.int64)
    values = tags_of_cells(domain, cell_tags)
    _check_cover(domain, cell_tags, values[: imap.size_local], tags)
    return [given[int(tag)] for tag in tags], np.searchsorted(tags, values).astype(np.int32)


def tags_of_cells(domain: mesh.Mesh, cell_tags: mesh.MeshTags) -> Longs:
    """Return the tags of the local cells, ghosts included, UNTAGGED without one; collective.

    Raises:
        ValueError: on all ranks, if the tags are not those of the cells of the mesh.
    """
    if not isinstance(cell_tags, mesh.MeshTags):
        raise ValueError(f"cell_tags is {cell_tags!r}: give a dolfinx.mesh.MeshTags of cells.")
    if cell_tags.dim != domain.topology.dim or not compat.on_same_mesh(cell_tags, domain):
        raise ValueError("cell_tags must tag the cells of the mesh of u, not of another mesh.")
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


def _check_cover(domain: mesh.Mesh, cell_tags: mesh.MeshTags, values: Longs, tags: Longs) -> None:
    """Raise ValueError on all ranks unless the values of the owned cells are the tags."""
    comm = domain.comm
    found = np.unique(np.concatenate(comm.allgather(np.unique(values))))
    missing = np.setdiff1d(found, tags)
    if missing.size:
        cells = comm.allreduce(int(np.isin(values, missing).sum()), op=MPI.SUM)
        named = ["no tag" if t == UNTAGGED else f"tag {label(cell_tags, t)}" for t in missing]
        raise ValueError(
            f"materials: {cells} cells have no material ({', '.join(named)}); "
            "add a material for each tag, and tag all cells."
        )
    empty = np.setdiff1d(tags, found)
    if empty.size:
        raise ValueError(
            f"materials: tag {labels(cell_tags, empty)} marks no cell; cell_tags has "
            f"{labels(cell_tags, found)}."
        )


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
