# SPDX-License-Identifier: MIT
r"""Energy stored in bodies and dissipated, from the potentials of their laws.

The potential of a step, psi(eps; state_n), is the least sum of the energy that is stored at its end
and of what is dissipated in it. At the state that the step has led to nothing flows, so that

    stored     = psi(eps; state),
    dissipated = psi(eps; state_n) - psi(eps; state),     added up over the steps,

exactly, for every law with a potential, at small and finite strain. Of `VonMises` the first is
1/2 eps_e : C : eps_e + a/2 |ep|^2 + H/2 k^2, the second Y times the length of the plastic path.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from mpi4py import MPI

import numpy as np

from dolfinx import fem, mesh
from dolfinx_mortar.materials.response import Response
from dolfinx_mortar.solid.laws import Region, tags_of_cells
from dolfinx_mortar.solid.points import PointFields
from dolfinx_mortar.solid.sources import Part, create_source, fill_all, point_function
from dolfinx_mortar.tags import names_of

STORED, DISSIPATED = "stored_energy", "dissipated_energy"


@dataclass(frozen=True)
class Energies:
    """What a body has stored, and dissipated since the start; per thickness in the plane."""

    stored: float
    dissipated: float


class EnergyDensities:
    """Densities per volume at X, at the integration points.

    Attributes:
        stored: quadrature Function, filled by `fill`.
    """

    def __init__(
        self,
        regions: Sequence[Region],
        responses: Sequence[Response],
        domain: mesh.Mesh,
        cell_tags: mesh.MeshTags | None,
        degree: int,
        *,
        of_volume: Callable[[], np.ndarray] | None = None,
    ) -> None:
        """Compile the potentials; collective.

        Args:
            regions: the laws and their cells.
            responses: of the laws.
            cell_tags: of the bodies, with their names; without, there is one.
            degree: of the quadrature.
            of_volume: gives what the responses leave out, a density (owned cells,), if they do.

        Raises:
            ValueError: if a law has no potential.
        """
        laws = [region.law.name for region in regions]
        pairs = list(zip(laws, responses, strict=True))
        without = [name for name, found in pairs if found.energy is None]
        if without:
            raise ValueError(
                f"energies is True, but {', '.join(without)} has a stress and no potential, of "
                "which stored and dissipated energies are parts: give the law an energy, or leave "
                "energies out"
            )
        self.stored = point_function(domain, degree, (), STORED)
        self._of_volume, self._mesh, self._cell_tags = of_volume, domain, cell_tags
        self._sources = [
            create_source(region.cells, Part(f"{name}: energy", self.stored, found.energy))
            for region, (name, found) in zip(regions, pairs, strict=True)
            if found.energy is not None
        ]

    def fill(
        self,
        committed: Mapping[str, fem.Function],
        staged: Mapping[str, fem.Function],
        follow: Callable[[], None],
    ) -> None:
        """Evaluate what is stored, and add to what is dissipated; collective.

        Args:
            committed: internal variables at the start of the step, with what is dissipated then.
            staged: those at its end; the same.
            follow: takes over what has changed at the points.
        """
        fill_all(self._mesh.comm, self._sources)
        potential = self.stored.x.array.copy()
        start = {name: f.x.array.copy() for name, f in committed.items()}
        try:
            for name, f in committed.items():
                f.x.array[:] = staged[name].x.array
            follow()
            fill_all(self._mesh.comm, self._sources)
        finally:
            for name, values in start.items():
                committed[name].x.array[:] = values
        lost = potential - self.stored.x.array
        staged[DISSIPATED].x.array[:] = committed[DISSIPATED].x.array + lost
        if self._of_volume is not None:
            density = self._of_volume()
            dofs = self.stored.function_space.dofmap.list[: len(density)]
            self.stored.x.array[dofs] += density[:, None]
            self.stored.x.scatter_forward()

    def by_body(self, fields: PointFields) -> dict[int | str, Energies]:
        """Return the energies of the cells of each tag, by its name if it has one; collective."""
        domain, named = self._mesh, self._cell_tags
        owned = domain.topology.index_map(domain.topology.dim).size_local
        tags = np.zeros(owned, dtype=np.int64)
        if named is not None:
            tags = tags_of_cells(domain, named)[:owned]
        every = np.unique(np.concatenate(domain.comm.allgather(np.unique(tags))))
        sums = np.zeros((len(every), 2))
        place = np.searchsorted(every, tags)
        for k, name in enumerate((STORED, DISSIPATED)):
            np.add.at(sums[:, k], place, (fields.values(name) * fields.weights).sum(axis=1))
        domain.comm.Allreduce(MPI.IN_PLACE, sums)
        names = {} if named is None else {tag: name for name, tag in names_of(named).items()}
        keys = [names.get(int(tag), int(tag)) for tag in every]
        return {key: Energies(*map(float, row)) for key, row in zip(keys, sums, strict=True)}
