# SPDX-License-Identifier: MIT
"""State and results of the bodies at the integration points, and their evaluation."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from dolfinx import fem
from dolfinx_mortar.arrays import Bools, Floats
from dolfinx_mortar.materials.protocol import Law
from dolfinx_mortar.solid.laws import Region, create_state
from dolfinx_mortar.solid.points import DISSIPATED, EnergyDensities
from dolfinx_mortar.solid.pointwise import PointValuesOfRegion, fill_point_values
from dolfinx_mortar.solid.sources import Followed, Source, create_field, fill_all, follow_changed


class PointState:
    """Internal variables, committed and of the last `evaluate`, stress, and their data.

    Attributes:
        committed: internal variables by name, from which a step starts.
        staged: those of the last `evaluate`.
        stress: filled by `evaluate`.
        shown: other Functions that `evaluate` fills, by name.
        followed: the parameters of the laws and the eigenstrain.
        found: values found before each assembly, by law.
        evaluations: of stress and new internal variables.
        densities: energies, if they are asked for.
    """

    found: Mapping[Law, PointValuesOfRegion]
    evaluations: Sequence[Source]
    densities: EnergyDensities | None = None

    def __init__(
        self, regions: Sequence[Region], degree: int, eigenstrain: Followed | None, energies: bool
    ) -> None:
        """Create the Functions; collective."""
        domain = regions[0].mesh
        self.committed = create_state(regions, domain, degree)
        if energies:
            self.committed[DISSIPATED] = create_field(domain, degree, (), DISSIPATED)
        self.staged = {name: f.copy() for name, f in self.committed.items()}
        self.stress = create_field(domain, degree, (3, 3), "stress")
        self.shown: dict[str, fem.Function] = {}
        self.followed: list[Followed] = [region.parameters for region in regions]
        self.followed += [] if eigenstrain is None else [eigenstrain]
        self._comm = domain.comm

    @property
    def follows(self) -> bool:
        """Whether parameters or the eigenstrain may change."""
        return any(one.varying for one in self.followed)

    def follow(self, dilatation: Callable[[], None] | None) -> None:
        """Update changed data, then the mean dilatation, then the laws; collective."""
        follow_changed(self._comm, self.followed)
        if dilatation is not None:
            dilatation()
        fill_point_values(self._comm, self.found)

    def evaluate(self, follow: Callable[[], None]) -> None:
        """Evaluate stress and internal variables; an error leaves all as before; collective."""
        fill_point_values(self._comm, self.found, at_end=True)
        if self.densities is None:
            fill_all(self._comm, self.evaluations)
            return
        kept = self.keep()
        try:
            fill_all(self._comm, self.evaluations)
            self.densities.fill(self.committed, self.staged, follow)
        except BaseException:
            self.put_back(kept)
            raise

    def commit(self) -> None:
        """Commit the internal variables of the last `evaluate`."""
        for name, staged in self.staged.items():
            self.committed[name].x.array[:] = staged.x.array

    def keep(self) -> list[tuple[fem.Function, Floats]]:
        """Copies of results, state, and their parameters, for `put_back`."""
        functions = [*self.lasting_fields().values(), *(one.function for one in self.followed)]
        return [(f, f.x.array.copy()) for f in functions]

    def put_back(self, kept: list[tuple[fem.Function, Floats]]) -> None:
        """Restore the results of `keep`; without communication."""
        for f, values in kept:
            f.x.array[:] = values
        for followed in self.followed:
            followed.forget()

    def lasting_fields(self) -> dict[str, fem.Function]:
        """Fields that are kept from step to step, by name."""
        committed = {f"committed/{name}": f for name, f in self.committed.items()}
        shown = {f"shown/{name}": f for name, f in self.staged.items()}
        return {"stress": self.stress} | committed | self.shown | shown

    def flowing(self) -> Bools:
        """Points (owned cells, points) at which `evaluate` has changed the state."""
        space = self.stress.function_space
        cells = space.mesh.topology.index_map(space.mesh.topology.dim).size_local
        changed = np.zeros((cells, space.dofmap.list.shape[1]), dtype=bool)
        for name, staged in self.staged.items():
            dofmap = staged.function_space.dofmap
            differs = staged.x.array != self.committed[name].x.array
            changed |= differs.reshape(-1, dofmap.bs).any(axis=1)[dofmap.list[:cells]]
        return changed
