# SPDX-License-Identifier: MIT
"""Fields at the integration points: stress, internal variables, norms, energies."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any

from mpi4py import MPI

import numpy as np

import ufl
from dolfinx import fem, mesh
from dolfinx_mortar.algebra.parallel import raised_together
from dolfinx_mortar.common.arguments import check, instance
from dolfinx_mortar.common.arrays import Bools, Floats
from dolfinx_mortar.common.tags import names_of
from dolfinx_mortar.materials.protocol import Law
from dolfinx_mortar.materials.response import Response
from dolfinx_mortar.materials.tensor import COMPONENTS, frobenius_norm, vector_norm, von_mises
from dolfinx_mortar.solid.laws import Region, create_state, measure, tags_of_cells
from dolfinx_mortar.solid.pointwise import PointValuesOfRegion, fill_point_values
from dolfinx_mortar.solid.sources import (
    Followed,
    Part,
    Source,
    create_source,
    fill_all,
    follow_changed,
    point_function,
    unchanged,
)

# Zero where no law defines them. Name -> whether it is a tensor.
PLASTIC_FIELDS = {"plastic_strain": True, "back_stress": True, "plastic": False}
# Name in the literature -> name here.
ALIASES = {"hardening": "back_stress_vector_norm"}


class PointFields:
    """Quadrature Functions and derived quantities on the owned cells."""

    def __init__(
        self,
        stress: fem.Function,
        state: Mapping[str, fem.Function],
        regions: Sequence[Region],
        degree: int,
        weight: Callable[[Any], Any],
    ) -> None:
        """Compile the weights; collective."""
        self._stored = {"stress": stress, **state}
        self._regions = regions
        self.degree = degree
        self._mesh = stress.function_space.mesh
        self._components = COMPONENTS[self._mesh.geometry.dim]
        self._owned = self._mesh.topology.index_map(self._mesh.topology.dim).size_local
        self._points = stress.function_space.dofmap.list.shape[1]
        self._averages: dict[str, fem.Function] = {}
        Q = point_function(self._mesh, degree).function_space
        factor = ufl.as_ufl(weight(ufl.SpatialCoordinate(self._mesh)))
        self._volume = fem.form(factor * ufl.TestFunction(Q) * measure(self._mesh, degree))
        self._places = Q.dofmap.list[: self._owned]  # in its vector

    @cached_property
    def bases(self) -> dict[str, tuple[int, ...]]:
        """Shapes, (components,) or (), of stress, state and output."""
        shapes: dict[str, tuple[int, ...]] = {
            name: (len(self._components),) if f.function_space.dofmap.bs > 1 else ()
            for name, f in self._stored.items()
        }
        for region in self._regions:
            none = np.arange(0, dtype=np.int32)
            for name, field in self._output(region, none).items():
                if shapes.setdefault(name, field.shape[1:]) != field.shape[1:]:
                    raise ValueError(
                        f"{region.law.name}.output: {name} has {field.shape[1:]} components, "
                        f"but {shapes[name]} in another law; give one of them another name."
                    )
        return shapes

    @cached_property
    def _shapes(self) -> dict[str, tuple[int, ...]]:
        """`bases`, and fields that no law defines."""
        size = (len(self._components),)
        zeros = {name: size if is_tensor else () for name, is_tensor in PLASTIC_FIELDS.items()}
        return zeros | self.bases

    @cached_property
    def _fields(self) -> dict[str, tuple[str, Any]]:
        """Name -> field from which each is calculated, and how; fields of laws first."""
        parts: dict[str, Any] = {"norm": frobenius_norm, "vector_norm": vector_norm}
        for k, component in enumerate(self._components):
            parts[component] = partial(np.take, indices=k, axis=-1)
        found: dict[str, tuple[str, Any]] = {name: (name, np.asarray) for name in self._shapes}
        found["von_mises"] = "stress", von_mises
        for base, shape in self._shapes.items():
            if shape == (len(self._components),):
                found |= {f"{base}_{part}": (base, how) for part, how in parts.items()}
        found |= {name: found[target] for name, target in ALIASES.items()}
        return found | {name: (name, np.asarray) for name in self.bases}

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all fields of the laws without single components."""
        given = self._fields.items()
        return tuple(
            n for n, (base, how) in given if base in self.bases and type(how) is not partial
        )

    @property
    def scalars(self) -> list[str]:
        """Names of all scalars, with norms and components of tensors."""
        return [n for n in self._fields if not self._shapes.get(n)]

    def values(self, name: str) -> np.ndarray:
        """Field on the owned cells: (cells, points) or (cells, points, components).

        Args:
            name: a stored field ("stress", "plastic_strain", an internal variable or output of a
                law such as "back_stress"), "plastic" (1 where there is plastic strain, else 0),
                "von_mises", a tensor's name with "_norm" (Frobenius), "_vector_norm" (stored
                components, shear once) or a component ("stress_yy"), or "hardening", the vector
                norm of the back stress. Fields of plasticity are zero in elastic bodies.

        Raises:
            ValueError: for an unknown field, or NaN of a law on this rank.
        """
        check("name", name, instance(str, f"give one of {', '.join(self.names)}"))
        if name not in self._fields:
            raise ValueError(f"no field {name!r}; there are {', '.join(self.names)}.")
        base, how = self._fields[name]
        return np.asarray(how(self._base(base)))

    def _base(self, name: str) -> np.ndarray:
        if name in self._stored:
            return self._at_points(self._stored[name])
        shape = self._shapes[name]
        result = np.zeros((self._owned, self._points, *shape))
        for region in self._regions:
            cells = region.cells[region.cells < self._owned]
            field = self._output(region, cells).get(name)
            if field is None:
                continue
            if (undefined := int(np.isnan(field).sum())) > 0:
                raise ValueError(f"{region.law.name}.output: {name} is NaN in {undefined} values.")
            result[cells] = field.reshape(cells.size, self._points, *shape)
        return result

    def _at_points(self, f: fem.Function) -> np.ndarray:
        """Quadrature Function on the owned cells, (cells, points[, components])."""
        dofmap = f.function_space.dofmap
        values = f.x.array.reshape(-1, dofmap.bs)[dofmap.list[: self._owned]]
        return values[..., 0] if dofmap.bs == 1 else values

    def _output(self, region: Region, cells: np.ndarray) -> dict[str, np.ndarray]:
        state = {}
        for name in region.law.state:
            values = self._at_points(self._stored[name])[cells]
            state[name] = values.reshape(cells.size * self._points, *values.shape[2:])
        fields = region.output(state, cells, self._points)
        if "plastic_strain" in state and "plastic" not in self._stored:
            strain = np.atleast_2d(state["plastic_strain"].T)  # (components, q)
            fields.setdefault("plastic", strain.any(axis=0).astype(float))
        return fields

    @cached_property
    def weights(self) -> np.ndarray:
        """Integration weights (cells, points); their sum is the volume."""
        return fem.assemble_vector(self._volume).array[self._places]

    def _values_everywhere(self, name: str) -> np.ndarray:
        """`values`, with errors of one rank raised on all; collective."""
        values = np.zeros(0)
        with raised_together(self._mesh.comm):
            values = self.values(name)
        return values

    def max(self, name: str) -> float:
        """Largest value of a scalar field over all ranks."""
        values = self._values_everywhere(name)
        if values.ndim > 2:
            raise ValueError(
                f"{name!r} is a tensor: ask for a norm or a component, '{name}_norm' or '{name}_xx'"
            )
        largest = float(values.max()) if values.size else -np.inf
        return self._mesh.comm.allreduce(largest, op=MPI.MAX)

    def integral(self, name: str) -> float:
        """Integral of a scalar field over all ranks."""
        return self._mesh.comm.allreduce(
            float(np.sum(self._values_everywhere(name) * self.weights)), op=MPI.SUM
        )

    def cell_values(self, name: str) -> fem.Function:
        """Cell averages as a DG0 Function, one per name and refilled."""
        values, weights = self._values_everywhere(name), self.weights
        if name not in self._averages:
            shape = values.shape[2:]
            space = fem.functionspace(self._mesh, ("DG", 0, shape))
            self._averages[name] = fem.Function(space, name=name)
        average = self._averages[name]
        flat = values.reshape(*values.shape[:2], math.prod(values.shape[2:]))
        means = np.einsum("cq,cqi->ci", weights, flat) / weights.sum(axis=1)[:, None]
        dofs = average.function_space.dofmap.list[: self._owned, 0]
        average.x.array.reshape(-1, flat.shape[2])[dofs] = means
        average.x.scatter_forward()
        return average


STORED, DISSIPATED = "stored_energy", "dissipated_energy"


@dataclass(frozen=True)
class Energies:
    """Stored energy, and dissipation since the start; per thickness in the plane."""

    stored: float
    dissipated: float


class EnergyDensities:
    """Densities per volume at X, at the integration points, for laws with a potential.

    The potential psi(eps; state_n) is the minimum of stored energy plus dissipation:

        stored     = psi(eps; state),
        dissipated = psi(eps; state_n) - psi(eps; state),     added up over the steps.

    Attributes:
        stored: quadrature Function, filled by `fill`.
    """

    def __init__(
        self,
        regions: Sequence[Region],
        responses: Sequence[Response],
        cell_tags: mesh.MeshTags | None,
        degree: int,
        *,
        of_volume: Callable[[], np.ndarray] | None = None,
    ) -> None:
        """Compile the potentials; `of_volume` gives densities (owned cells,) to add; collective.

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
        self._of_volume, self._mesh, self._cell_tags = of_volume, regions[0].mesh, cell_tags
        self.stored = point_function(self._mesh, degree, (), STORED)
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
        """Evaluate the stored energy, and add to the dissipated; collective.

        `committed` and `staged`: internal variables at the start and end of the step.
        """
        fill_all(self._mesh.comm, self._sources)
        potential = self.stored.x.array.copy()
        with unchanged(committed.values()):
            for name, f in committed.items():
                f.x.array[:] = staged[name].x.array
            follow()
            fill_all(self._mesh.comm, self._sources)
        lost = potential - self.stored.x.array
        staged[DISSIPATED].x.array[:] = committed[DISSIPATED].x.array + lost
        if self._of_volume is not None:
            density = self._of_volume()
            dofs = self.stored.function_space.dofmap.list[: len(density)]
            self.stored.x.array[dofs] += density[:, None]
            self.stored.x.scatter_forward()

    def by_body(self, fields: PointFields) -> dict[int | str, Energies]:
        """Energies by tag or name of cells; collective."""
        domain, named = self._mesh, self._cell_tags
        owned = domain.topology.index_map(domain.topology.dim).size_local
        tags = np.zeros(owned, dtype=np.int64)
        if named is not None:
            tags = tags_of_cells(domain, named)[:owned]
        every = sorted(set().union(*domain.comm.allgather(set(tags.tolist()))))
        of_cells = [
            (fields.values(name) * fields.weights).sum(axis=1) for name in (STORED, DISSIPATED)
        ]
        shares = np.array([[part[tags == tag].sum() for part in of_cells] for tag in every])
        sums = domain.comm.allreduce(shares).tolist()
        names = {} if named is None else {tag: name for name, tag in names_of(named).items()}
        return {names.get(tag, tag): Energies(*row) for tag, row in zip(every, sums, strict=True)}


class PointState:
    """Internal variables, committed and of the last `evaluate`, stress, and their data.

    Attributes:
        committed: internal variables at the start of the step, by name.
        staged: those of the last `evaluate`.
        shown: other Functions filled by `evaluate`, by name.
        followed: the parameters of the laws and the eigenstrain.
        densities: energies, if requested.
    """

    found: Mapping[Law, PointValuesOfRegion]
    evaluations: Sequence[Source]
    densities: EnergyDensities | None = None

    def __init__(
        self, regions: Sequence[Region], degree: int, eigenstrain: Followed | None, energies: bool
    ) -> None:
        domain = regions[0].mesh
        self.committed = create_state(regions, domain, degree)
        if energies:
            self.committed[DISSIPATED] = point_function(domain, degree, (), DISSIPATED)
        self.staged = {name: f.copy() for name, f in self.committed.items()}
        self.stress = point_function(domain, degree, (3, 3), "stress")
        self.shown: dict[str, fem.Function] = {}
        self.followed: list[Followed] = [*regions]
        self.followed += [] if eigenstrain is None else [eigenstrain]
        self._comm = domain.comm

    @property
    def follows(self) -> bool:
        """Whether parameters or the eigenstrain may change."""
        return any(one.varying for one in self.followed)

    def follow(self, dilatation: Callable[[], None] | None) -> None:
        """Update data, then the mean dilatation, then the laws; collective."""
        follow_changed(self._comm, self.followed)
        if dilatation is not None:
            dilatation()
        fill_point_values(self._comm, self.found)

    def evaluate(self, follow: Callable[[], None]) -> None:
        """Evaluate stress and internal variables, or change nothing; collective."""
        fill_point_values(self._comm, self.found, at_end=True)
        with unchanged(self.lasting_fields().values(), on_error=True):
            fill_all(self._comm, self.evaluations)
            if self.densities is not None:
                self.densities.fill(self.committed, self.staged, follow)

    def commit(self) -> None:
        """Commit the internal variables of the last `evaluate`."""
        for name, staged in self.staged.items():
            self.committed[name].x.array[:] = staged.x.array

    def keep(self) -> list[tuple[fem.Function, Floats]]:
        """Copies of results, state and parameters, for `put_back`."""
        functions = [*self.lasting_fields().values(), *(one.function for one in self.followed)]
        return [(f, f.x.array.copy()) for f in functions]

    def put_back(self, kept: list[tuple[fem.Function, Floats]]) -> None:
        """Restore the results of `keep`; not collective."""
        for f, values in kept:
            f.x.array[:] = values
        for followed in self.followed:
            followed.forget()

    def lasting_fields(self) -> dict[str, fem.Function]:
        """Fields of a checkpoint, by name."""
        committed = {f"committed/{name}": f for name, f in self.committed.items()}
        shown = {f"shown/{name}": f for name, f in self.staged.items()}
        return {"stress": self.stress} | committed | self.shown | shown

    def flowing(self) -> Bools:
        """Points (owned cells, points) whose state has changed."""
        space = self.stress.function_space
        cells = space.mesh.topology.index_map(space.mesh.topology.dim).size_local
        changed = np.zeros((cells, space.dofmap.list.shape[1]), dtype=bool)
        for name, staged in self.staged.items():
            dofmap = staged.function_space.dofmap
            differs = staged.x.array != self.committed[name].x.array
            changed |= differs.reshape(-1, dofmap.bs).any(axis=1)[dofmap.list[:cells]]
        return changed
