# SPDX-License-Identifier: MIT
"""Regions: the law, parameters and internal variables of cells; eigenstrains of cells."""

import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from numbers import Number
from operator import add
from typing import Any, TypeVar

from mpi4py import MPI

import numpy as np

import ufl
from dolfinx import fem, mesh
from dolfinx_mortar.algebra.parallel import maximum, raised_together
from dolfinx_mortar.common.arguments import array, check
from dolfinx_mortar.common.arrays import HALF_OF_DIGITS, Bools, Floats, Ints, Longs
from dolfinx_mortar.common.tags import by_tag, check_entities, label, labels, tags_of
from dolfinx_mortar.materials import Material
from dolfinx_mortar.materials.protocol import (
    RESERVED,
    Law,
    create_law,
    grouped,
    named_parameters,
    wrong_values,
)
from dolfinx_mortar.materials.response import Response
from dolfinx_mortar.materials.tensor import from_components
from dolfinx_mortar.solid.kinematics import Kinematics
from dolfinx_mortar.solid.sources import (
    Followed,
    Part,
    Source,
    check_source,
    create_source,
    middle_of,
    point_function,
)
from ufl.algorithms.analysis import extract_arguments
from ufl.checks import is_cellwise_constant
from ufl.core.expr import Expr

T = TypeVar("T")

UNTAGGED = int(np.iinfo(np.int32).min)


class Region(Followed):
    """The cells of one law, and its parameters.

    Attributes:
        law: the law.
        parts: materials, each with its local cells.
        cells: int32 (m,), local cells, ghosts included.
        function: parameters per cell or point.
        names: of the parameters.
        symbols: the parameters by name, as UFL.
    """

    def __init__(
        self, u: fem.Function, law: Law, parts: Sequence[tuple[Any, Ints]], degree: int
    ) -> None:
        """Create the parameters of materials of one law, for `follow`; collective.

        Args:
            u: displacement, on which no parameter may depend.
            parts: see above.
            degree: of the quadrature of the solid.

        Raises:
            ValueError: on all ranks, if a parameter depends on u, another mesh or other points.
        """
        self.law, self.parts, self.mesh = law, parts, u.function_space.mesh
        self.cells = np.sort(np.concatenate([cells for _, cells in parts]))
        self.names = names = list(named_parameters(parts[0][0]))
        given = [
            (cells, i, value)
            for material, cells in parts
            for i, value in enumerate(named_parameters(material).values())
        ]
        moving = [(cells, i, value) for cells, i, value in given if isinstance(value, Expr)]
        for _, i, value in moving:
            check_source(u, f"{law.name}: {names[i]}", value)
        width = max(len(names), 1)  # a law may have no parameter
        if all(is_cellwise_constant(value) for _, _, value in moving):
            function = fem.Function(fem.functionspace(self.mesh, ("DG", 0, (width,))))
        else:
            function = point_function(self.mesh, degree, (width,))
        points, table = function.function_space.dofmap.list, function.x.array.reshape(-1, width)
        for cells, i, value in given:
            if not isinstance(value, Expr):
                table[points[cells], i] = value
        sources = [
            create_source(on, Part(f"{law.name}: {names[i]}", function, value, slice(i, i + 1)))
            for on, i, value in moving
        ]
        super().__init__(function, sources)
        self.symbols = grouped({name: function[i] for i, name in enumerate(names)})

    def parameters(self, cells: Ints, points: int) -> dict[str, Floats]:
        """Parameters by name, (cells * points,) each."""
        dofmap = self.function.function_space.dofmap
        table = self.function.x.array.reshape(-1, dofmap.bs)[dofmap.list[cells]]
        table = np.broadcast_to(table, (len(cells), points, dofmap.bs))
        columns = table.reshape(len(cells) * points, dofmap.bs).T
        return dict(zip(self.names, columns, strict=False))  # a law may have none

    def judge(self) -> None:
        """Raise a ValueError on all ranks if a parameter is out of range; collective."""
        V = self.function.function_space
        domain, points = V.mesh, V.dofmap.list.shape[1]
        size = domain.topology.index_map(domain.topology.dim).size_local
        owned = self.cells[self.cells < size]
        values = self.parameters(owned, points)
        wrong: dict[str, Bools] = {}
        with raised_together(domain.comm):
            if len(owned):  # users' rules may fail on empty arrays
                law = self.law
                wrong = wrong_values(law.name, law.ranges, law.conditions, values)
        rules = sorted(set().union(*domain.comm.allgather(set(wrong))))
        for rule in rules[:1]:
            where = wrong.get(rule, np.zeros(len(owned) * points, dtype=bool))
            bad = where.reshape(-1, points).any(axis=1)
            count = domain.comm.allreduce(int(bad.sum()), op=MPI.SUM)
            places = domain.comm.allgather(middle_of(domain, owned[bad][0]) if bad.any() else "")
            numbers = _extent(domain.comm, {name: v[where] for name, v in values.items()}, rule)
            raise ValueError(
                f"{self.law.name}: {rule} does not hold in {count} cells, such as the one "
                f"around {next(filter(None, places))}; there {numbers}."
            )

    def tensors(self, state: Mapping[str, fem.Function]) -> dict[str, Expr]:
        """Internal variables in UFL by name, () or (3, 3)."""
        return {
            name: from_components(state[name]) if shape else state[name]
            for name, shape in self.law.state.items()
        }

    def output(self, state: Mapping[str, Floats], cells: Ints, points: int) -> dict[str, Floats]:
        """Output (q,) or (q, components), cell by cell; a ValueError names a failing law."""
        if self.law.output is None:
            return {}
        where, q = f"{self.law.name}.output", len(cells) * points
        try:
            found = self.law.output(state, grouped(self.parameters(cells, points)))
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


def _extent(comm: MPI.Comm, values: Mapping[str, Floats], rule: str) -> str:
    parts = []
    for name in sorted(set(values) & set(re.findall(r"\w+", rule))):
        low = np.nanmin(values[name], initial=np.inf)
        high = np.nanmax(values[name], initial=-np.inf)
        low, high = comm.allreduce(float(low), op=MPI.MIN), comm.allreduce(float(high), op=MPI.MAX)
        undefined = comm.allreduce(bool(np.isnan(values[name]).any()), op=MPI.LOR)
        parts.append(f"{name} is NaN" if undefined else f"{name} is {low:.6g} to {high:.6g}")
    return ", ".join(parts)


def create_regions(
    u: fem.Function,
    materials: Material | Mapping[int | str, Material],
    cell_tags: mesh.MeshTags | None,
    degree: int,
    kinematics: Kinematics,
) -> list[Region]:
    """Group the cells by law and store the parameters; collective.

    Raises:
        ValueError: for wrong laws, tags or parameters, and cells without a law.
    """
    how = kinematics.plane_stress
    given, choice = _material_of_cells(u.function_space.mesh, materials, cell_tags, how)
    for _, law in given:
        if law.strain == "finite" and not kinematics.finite:
            raise ValueError(
                f"materials: {law.name} is a law of the deformation gradient: choose "
                "Solid(.., strain='finite')"
            )
    # one region per class, state and form at finite strain; sorted by name so that the order of the
    # dictionary does not change the forms
    alike: dict[Any, list[int]] = {}
    for i, (material, law) in enumerate(given):
        form = kinematics.finite and law.isotropic
        names = tuple(named_parameters(material))  # tuples may differ in length
        way = form, names
        alike.setdefault((type(material), way, *law.state), []).append(i)
    regions = []
    for kind in sorted(alike, key=lambda kind: (kind[0].__qualname__, kind[2:], kind[1])):
        chosen = alike[kind]
        law = given[chosen[0]][1]
        parts = [(given[i][0], np.flatnonzero(choice == i).astype(np.int32)) for i in chosen]
        regions.append(Region(u, law, parts, degree))
        regions[-1].follow()
    return regions


def create_state(
    regions: Sequence[Region], domain: mesh.Mesh, degree: int
) -> dict[str, fem.Function]:
    """Create the internal variables, shared by name; a ValueError for two shapes."""
    shapes: dict[str, tuple[int, ...]] = {}
    owner: dict[str, str] = {}
    for region in regions:
        for name, shape in region.law.state.items():
            first = owner.setdefault(name, region.law.name)
            if shapes.setdefault(name, shape) != shape:
                raise ValueError(
                    f"materials: the state {name!r} has the shape {shapes[name]} in {first} and "
                    f"{shape} in {region.law.name}; give one of them another name."
                )
    return {name: point_function(domain, degree, shape, name) for name, shape in shapes.items()}


def create_evaluations(
    regions: Sequence[Region],
    responses: Sequence[Response],
    staged: Mapping[str, fem.Function],
    stress: fem.Function,
) -> list[Source]:
    """Compile stress and new internal variables of all regions; collective."""
    evaluations = []
    for region, response in zip(regions, responses, strict=True):
        given = [("stress", stress, response.stress)]
        given += [(name, staged[name], value) for name, value in response.updated.items()]
        parts = (Part(f"{region.law.name}: {name}", f, value) for name, f, value in given)
        evaluations.append(create_source(region.cells, *parts))
    return evaluations


def _material_of_cells(
    domain: mesh.Mesh,
    materials: Material | Mapping[int | str, Material],
    cell_tags: mesh.MeshTags | None,
    plane_stress: bool,
) -> tuple[list[tuple[Any, Law]], np.ndarray]:
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
    """Entries of an argument by tag, and the tags of the local cells; collective.

    `given` by tag or name; `cover`: each cell must have an entry.

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
    """Tags of the local cells, UNTAGGED without one; collective."""
    check("cell_tags", cell_tags, tags_of(domain, domain.topology.dim))
    with raised_together(domain.comm):
        check_entities("cell_tags", cell_tags)
    imap = domain.topology.index_map(domain.topology.dim)
    # by a DG0 Function, so that ghost cells get their owner's tag
    marker = fem.Function(fem.functionspace(domain, ("DG", 0)))
    dofs = marker.function_space.dofmap.list[:, 0]
    marker.x.array[:] = float(UNTAGGED)
    marker.x.array[dofs[cell_tags.indices]] = cell_tags.values
    marker.x.scatter_forward()
    return np.asarray(marker.x.array[dofs[: imap.size_local + imap.num_ghosts]].astype(np.int64))


def measure(domain: mesh.Mesh, degree: int) -> ufl.Measure:
    """Measure of all cells, with the quadrature of a solid."""
    metadata = {"quadrature_degree": degree, "quadrature_scheme": "default"}
    return ufl.Measure("dx", domain, metadata=metadata)


@dataclass(frozen=True)
class Integral:
    """Integrals of a density per region, with the weight of the kinematics."""

    regions: Sequence[Region]
    kinematics: Kinematics
    degree: int

    @property
    def weight(self) -> Expr:
        """Volume per integrated area or volume."""
        x = ufl.SpatialCoordinate(self.regions[0].mesh)
        return ufl.as_ufl(self.kinematics.weight(x))

    def __call__(self, densities: Iterable[Expr]) -> ufl.Form:
        """Sum of the integrals."""
        regions, domain = self.regions, self.regions[0].mesh
        dx = measure(domain, self.degree)
        owned = domain.topology.index_map(domain.topology.dim).size_local
        # not the user's tags, which must not enter the compiled code
        cells = [(i, r.cells[r.cells < owned]) for i, r in enumerate(regions)]
        parts = dx(subdomain_data=cells)
        measures = [parts(i) for i, _ in cells] if len(cells) > 1 else [dx]
        pairs = zip(densities, measures, strict=True)
        return reduce(add, (self.weight * density * on for density, on in pairs))


WANTED = (
    "give a scalar (the same in all three directions) or a 3x3 tensor, as a real number, an array, "
    "a Constant, a Function or UFL"
)


class Eigenstrain(Followed):
    """Eigenstrain at the integration points of a mesh, zero by default.

    Attributes:
        function: a scalar, if isotropic, else the nine components row by row.
    """

    def __init__(
        self,
        u: fem.Function,
        parts: Sequence[tuple[str, Expr, Ints]],
        degree: int,
        finite: bool,
    ) -> None:
        """Compile the parts, each with name, scalar or 3x3 tensor and cells; collective."""
        self._finite = finite
        full = any(value.ufl_shape for _, value, _ in parts)
        shape = (9,) if full else ()
        function = point_function(u.function_space.mesh, degree, shape, "eigenstrain")
        sources = []
        for name, value, cells in parts:
            if full:
                tensor = value if value.ufl_shape else value * ufl.Identity(3)
                value = ufl.as_vector([tensor[i, j] for i in range(3) for j in range(3)])
            sources.append(create_source(cells, Part(name, function, value)))
        super().__init__(function, sources)

    @property
    def tensor(self) -> Expr:
        """The eigenstrain as a 3x3 tensor in UFL."""
        return self.tensor_of(self.function)

    @property
    def growth(self) -> Expr:
        """Deformation gradient of the stress-free state, I + eigenstrain."""
        return ufl.Identity(3) + self.tensor

    @property
    def inverse(self) -> Expr:
        """Inverse of `growth`."""
        f = self.function
        return ufl.inv(self.growth) if f.ufl_shape else 1 / (1 + f) * ufl.Identity(3)

    def of_whole(self, response: Response) -> Response:
        """Response to F, per volume at X, of that to F_e, per volume of the stress-free state."""
        inverse, J = self.inverse, ufl.det(self.growth)

        def stress(P: Expr) -> Expr:
            return J * P * inverse

        return replace(
            response,
            stress=stress(response.stress),
            energy=None if response.energy is None else J * response.energy,
            change=lambda direction: stress(response.change(direction * inverse)),
        )

    @staticmethod
    def tensor_of(f: fem.Function) -> Expr:
        """3x3 tensor of a Function such as `function`."""
        if not f.ufl_shape:
            return f * ufl.Identity(3)
        return ufl.sym(ufl.as_tensor([[f[3 * i + j] for j in range(3)] for i in range(3)]))

    def judge(self) -> None:
        """Raise a ValueError for NaN, infinity, asymmetry, shear out of the plane, or -1."""
        V = self.function.function_space
        owned = V.mesh.topology.index_map(V.mesh.topology.dim).size_local
        table = self.function.x.array.reshape(-1, V.dofmap.bs)
        for source in self._sources:
            cells = source.cells[source.cells < owned]
            values = table[V.dofmap.list[cells].ravel()]
            e = values.reshape(-1, 3, 3) if V.dofmap.bs == 9 else values[..., None] * np.eye(3)
            undefined = ~np.isfinite(e).all(axis=(1, 2))
            e[undefined] = 0.0
            largest = maximum(V.mesh.comm, np.abs(e).max(initial=0.0))[0]
            # derivatives of interpolated fields lose digits
            apart = np.abs(e - np.swapaxes(e, 1, 2)) > HALF_OF_DIGITS * largest
            shear = (e[:, :2, 2] + e[:, 2, :2] != 0.0).any(axis=1) & (V.mesh.geometry.dim == 2)
            gone = (np.linalg.eigvalsh(e)[:, 0] <= -1.0) & self._finite
            skew = apart.any(axis=(1, 2))
            counts = np.sum([undefined, skew, shear, gone], axis=1)
            bad = V.mesh.comm.allreduce(counts, op=MPI.SUM)
            told = {
                "is NaN or infinite": "check what it depends on",
                "is not symmetric": "give its symmetric part, ufl.sym(..) or (e + e.T) / 2",
                "has components xz or yz": "bodies in the plane cannot follow: set them to 0",
                "is -1 or below": "it is a change of lengths, over the lengths",
            }
            for count, (what, remedy) in zip(bad, told.items(), strict=True):
                if count:
                    raise ValueError(
                        f"{source.parts[0].name} {what} at {count} integration points; {remedy}"
                    )


def create_eigenstrain(
    u: fem.Function, given: Any, cell_tags: mesh.MeshTags | None, degree: int, finite: bool
) -> Eigenstrain | None:
    """Eigenstrain given by a user, or None; collective."""
    if given is None:
        return None
    domain, parts = u.function_space.mesh, []
    imap = domain.topology.index_map(domain.topology.dim)
    every = np.arange(imap.size_local + imap.num_ghosts, dtype=np.int32)
    of_cells = [("eigenstrain", given, every)]
    if isinstance(given, Mapping):
        by_tag, tags = by_cells(domain, cell_tags, given, "eigenstrain")
        of_cells = [
            (f"eigenstrain[{label(cell_tags, tag)}]", value, every[tags == tag])
            for tag, value in by_tag.items()
        ]
    for name, value, cells in of_cells:
        with raised_together(domain.comm):
            parts.append((name, _as_expression(u, name, value), cells))
    found = Eigenstrain(u, parts, degree, finite)
    found.follow()
    return found


def _as_expression(u: fem.Function, name: str, value: Any) -> Expr:
    domain = u.function_space.mesh
    if isinstance(value, Number | np.ndarray | list | tuple):
        value = fem.Constant(domain, check(name, value, array(finite=False, remedy=WANTED)))
    if not isinstance(value, Expr) or value.ufl_free_indices or extract_arguments(value):
        raise ValueError(f"{name} is a {type(value).__name__}: {WANTED}")
    if value.ufl_shape not in ((), (3, 3)):
        out = "; a strain in the plane has a component out of it, too" * (value.ufl_shape == (2, 2))
        raise ValueError(f"{name} has the shape {value.ufl_shape}: {WANTED}{out}")
    check_source(u, name, value)
    return value
