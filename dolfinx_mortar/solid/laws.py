# SPDX-License-Identifier: MIT
"""Which law holds in which cells: the user's tags turned into one region per law."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

from mpi4py import MPI

import numpy as np

import basix.ufl
from dolfinx import fem, mesh
from dolfinx_mortar import compat
from dolfinx_mortar.arrays import Floats, Ints
from dolfinx_mortar.materials import Material
from dolfinx_mortar.materials.protocol import RESERVED, check_declaration


@dataclass(frozen=True)
class Region:
    """The cells of one law, whatever the values of its parameters."""

    law: Any  # the class of the material
    cells: np.ndarray  # int32 (m,), local cells, ghosts included
    parameters: fem.Function  # DG0, one component per parameter of the law
    symbols: SimpleNamespace  # the parameters by name, as UFL

    def parameter_values(self, cells: np.ndarray) -> SimpleNamespace:
        """Return the parameters by name, each (len(cells),)."""
        dofs = self.parameters.function_space.dofmap.list[cells, 0]
        names = vars(self.symbols)
        values = self.parameters.x.array.reshape(-1, max(len(names), 1))[dofs]
        return SimpleNamespace(**{name: values[:, i] for i, name in enumerate(names)})

    def output(self, state: Mapping[str, Floats], cells: Ints, points: int) -> dict[str, Floats]:
        """Return the further fields of the law, (q,) or (q, components), q points cell by cell.

        Args:
            state: internal variables at the points of the cells, (q,) or (q, components).
            cells: local cells.
            points: number of integration points per cell.

        Raises:
            ValueError: if the law raises or returns something wrong; the message names it.
        """
        if not callable(getattr(self.law, "output", None)):
            return {}
        where, q = f"{self.law.__name__}.output", len(cells) * points
        try:
            found = self.law.output(state, self.parameter_values(np.repeat(cells, points)))
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
    domain: mesh.Mesh,
    materials: Material | Mapping[int, Material],
    cell_tags: mesh.MeshTags | None,
) -> list[Region]:
    """Group the cells by law and store the parameters cell by cell (collective).

    Raises:
        ValueError: if tags and materials do not cover the cells exactly.
    """
    laws, choice = _material_of_cells(domain, materials, cell_tags)
    # Sorted by name so that the same laws make the same forms in any order of the dictionary.
    classes = sorted(dict.fromkeys(type(law) for law in laws), key=lambda c: c.__qualname__)
    index = np.array([classes.index(type(law)) for law in laws])
    return [_create_region(domain, laws, choice, index == i) for i in range(len(classes))]


def _create_region(
    domain: mesh.Mesh, laws: list[Any], choice: np.ndarray, chosen: np.ndarray
) -> Region:
    """Create the region of the chosen laws, all of one class.

    Args:
        domain: the mesh.
        laws: all materials.
        choice: (cells,) index into laws per local cell.
        chosen: (len(laws),) bool, those of this region.
    """
    law = type(laws[int(np.flatnonzero(chosen)[0])])
    names = [field.name for field in dataclasses.fields(law)]
    width = max(len(names), 1)  # a law may have no parameter at all
    element = basix.ufl.element("DG", domain.basix_cell(), 0, shape=(width,))
    parameters = fem.Function(fem.functionspace(domain, element))
    cells = np.flatnonzero(chosen[choice]).astype(np.int32)
    table = np.array(
        [[getattr(m, n) if c else 0.0 for n in names] for m, c in zip(laws, chosen, strict=True)]
    )
    dofs = parameters.function_space.dofmap.list[:, 0]
    if names:
        parameters.x.array.reshape(-1, width)[dofs[cells]] = table[choice[cells]]
    symbols = SimpleNamespace(**{name: parameters[i] for i, name in enumerate(names)})
    return Region(law, cells, parameters, symbols)


def _material_of_cells(
    domain: mesh.Mesh,
    materials: Material | Mapping[int, Material],
    cell_tags: mesh.MeshTags | None,
) -> tuple[list[Any], np.ndarray]:
    """Return the materials and, per local cell (ghosts included), the index of its material."""
    imap = domain.topology.index_map(domain.topology.dim)
    count = imap.size_local + imap.num_ghosts
    if not isinstance(materials, Mapping):
        check_declaration("materials", materials)
        return [materials], np.zeros(count, dtype=np.int32)
    for tag, law in materials.items():
        if not isinstance(tag, int | np.integer):
            raise ValueError(f"materials has the key {tag!r}: its keys are cell tags, integers.")
        check_declaration(f"materials[{tag}]", law)
    if not materials or cell_tags is None:
        raise ValueError(
            "materials is a dictionary by cell tag: give at least one material, and cell_tags."
        )
    if cell_tags.dim != domain.topology.dim or not compat.on_same_mesh(cell_tags, domain):
        raise ValueError("cell_tags must tag the cells of the mesh of u, not of another mesh.")
    tags = np.array(sorted(materials), dtype=np.int64)
    # Through a DG0 Function, so that ghost cells get their owner's tag.
    marker = fem.Function(fem.functionspace(domain, ("DG", 0)))
    dofs = marker.function_space.dofmap.list[:, 0]
    untagged = float(np.iinfo(np.int32).min)
    marker.x.array[:] = untagged
    marker.x.array[dofs[cell_tags.indices]] = cell_tags.values
    marker.x.scatter_forward()
    values = marker.x.array[dofs[:count]].astype(np.int64)
    _check_cover(domain.comm, values[: imap.size_local], tags, int(untagged))
    laws = [materials[int(tag)] for tag in tags]
    return laws, np.searchsorted(tags, values).astype(np.int32)


def _check_cover(comm: MPI.Comm, values: np.ndarray, tags: np.ndarray, untagged: int) -> None:
    """Raise ValueError on all ranks unless the tags of the owned cells and `tags` are the same."""
    found = np.unique(np.concatenate(comm.allgather(np.unique(values))))
    missing = np.setdiff1d(found, tags)
    if missing.size:
        cells = comm.allreduce(int(np.isin(values, missing).sum()), op=MPI.SUM)
        named = ["no tag" if tag == untagged else f"tag {tag}" for tag in missing]
        raise ValueError(
            f"materials: {cells} cells have no material ({', '.join(named)}); "
            "add a material for each tag, and tag all cells."
        )
    empty = np.setdiff1d(tags, found)
    if empty.size:
        raise ValueError(
            f"materials: tag {', '.join(map(str, empty))} marks no cell; cell_tags has "
            f"{', '.join(map(str, found))}."
        )
