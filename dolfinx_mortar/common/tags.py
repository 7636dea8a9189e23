# SPDX-License-Identifier: MIT
"""Named tags of cells or facets."""

from collections.abc import Iterable, Mapping
from difflib import get_close_matches
from types import MappingProxyType
from typing import Any, TypeVar

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

import ufl
from dolfinx import mesh
from dolfinx_mortar.common.arguments import Rule, check, instance, integer, is_integer
from dolfinx_mortar.common.arrays import Ints
from dolfinx_mortar.common.compat import on_same_mesh

Value = TypeVar("Value")


class Tags(mesh.MeshTags):
    """Tags of cells or facets that have names.

    Names can stand for tags in `Contact`, `Tie`, keys of materials and eigenstrains, and ``find``,
    but not in UFL: ``ds(facet_tags.tag("top"))``.

        facet_tags = dm.Tags(facet_tags, {"ball": 3, "plate": 4})

    Attributes:
        names: tag by name, in the order of the tags.
    """

    def __init__(self, tags: mesh.MeshTags, names: Mapping[str, int]) -> None:
        """Name tags, the same on all ranks; not every tag needs a name."""
        check("tags", tags, instance(mesh.MeshTags, "give a dolfinx.mesh.MeshTags"))
        check("names", names, instance(Mapping, "give a dictionary, name -> tag"))
        for name, tag in names.items():
            check("names: a name", name or None, instance(str, "give a text"))
            check_tag(f"names: {name!r}", tag)
        super().__init__(in_order(tags)._cpp_object)
        self.names: Mapping[str, int] = MappingProxyType(
            {name: int(tag) for name, tag in sorted(names.items(), key=lambda item: item[1])}
        )

    def tag(self, name: str | int) -> int:
        """Tag of a name, or a tag unchanged.

        Raises:
            ValueError: for unknown names, and non-integers or more than 32 bits.
        """
        return tag_of(self, name, "name")

    def find(self, value: int | str) -> npt.NDArray[np.int32]:
        """Local cells or facets (n,) of a tag or name."""
        return np.asarray(super().find(tag_of(self, value, "value")))


def in_order(tags: mesh.MeshTags) -> mesh.MeshTags:
    """Tags with ascending entities, as dolfinx's ``ds`` needs."""
    order = np.argsort(tags.indices, kind="stable")
    if (np.diff(order) == 1).all():
        return tags
    of, names = tags._cpp_object, names_of(tags)
    found = mesh.MeshTags(type(of)(of.topology, of.dim, of.indices[order], of.values[order]))
    found.name = tags.name
    return Tags(found, names) if names else found


def find_exterior(tags: mesh.MeshTags, tag: int, domain: mesh.Mesh) -> tuple[Ints, Ints]:
    """Owned facets of a tag, and those on the boundary; collective."""
    topology = domain.topology
    topology.create_connectivity(tags.dim, topology.dim)
    marked = tags.find(tag)
    marked = marked[marked < topology.index_map(tags.dim).size_local]
    return marked, np.intersect1d(marked, mesh.exterior_facet_indices(topology))


def tags_of(domain: mesh.Mesh, dim: int) -> Rule[mesh.MeshTags]:
    """Rule for tags of cells or facets of a mesh."""
    sort = "cells" if dim == domain.topology.dim else "facets"

    def read(tags: Any) -> mesh.MeshTags | None:
        known = isinstance(tags, mesh.MeshTags) and tags.dim == dim
        return tags if known and on_same_mesh(tags, domain) else None

    return Rule(f"give MeshTags of the {sort} (dimension {dim}) of the same mesh", read)


def check_measures(name: str, form: ufl.Form, domain: mesh.Mesh) -> None:
    """Raise a ValueError on all ranks for measures that lose cells or facets; collective."""
    dims = {"cell": domain.topology.dim, "exterior_facet": domain.topology.dim - 1}
    for integral in form.integrals():
        tag, tags = integral.subdomain_id(), integral.subdomain_data()
        kind = integral.integral_type()
        if not is_integer(tag) or kind not in dims or isinstance(tags, list):
            continue
        sort, on = ("dx", "cells") if kind == "cell" else ("ds", "facets")
        measure = f"{name}: {sort}({label(tags, tag)})"
        rule = tags_of(domain, dims[kind])
        check(f"{measure}: subdomain_data", tags, rule, f"{rule.remedy} to ufl.Measure")
        marked = found = tags.find(tag)
        if kind != "cell":
            marked, found = find_exterior(tags, tag, domain)
        shuffled = kind != "cell" and bool((np.diff(marked) < 0).any())
        counts = domain.comm.allreduce(np.array([len(marked), len(found), shuffled]))
        if counts[2]:
            raise ValueError(
                f"{measure}: the facets of the tags are not sorted, so that dolfinx would lose "
                "some: sort indices and values before dolfinx.mesh.meshtags, or give them names, "
                "tags = dolfinx_mortar.Tags(tags, {..}), which sorts"
            )
        if not counts[1]:
            why = (
                "all of its facets lie inside the mesh"
                if counts[0]
                else f"no {on[:-1]} has this tag; the tags are {all_labels(domain.comm, tags)}"
            )
            raise ValueError(f"{measure} acts nowhere: {why}")


def check_tag(name: str, tag: Any) -> int:
    """The tag, or a ValueError for values that MeshTags cannot hold."""
    limits = np.iinfo(np.int32)
    remedy = "give a tag, an integer of 32 bits, or its name"
    return check(name, tag, integer(limits.min, limits.max), remedy)


def check_entities(name: str, tags: mesh.MeshTags) -> None:
    """Raise a ValueError for entities that this rank does not have."""
    layout = tags.topology.index_map(tags.dim)
    count = layout.size_local + layout.num_ghosts
    outside = tags.indices[(tags.indices < 0) | (tags.indices >= count)]
    if len(outside):
        raise ValueError(
            f"{name} mark the entity {outside[0]} of dimension {tags.dim}, but this rank has 0 to "
            f"{count - 1}: take them from dolfinx.mesh.locate_entities"
        )


def tag_of(tags: Any, given: Any, argument: str) -> int:
    """Tag of a name, or a tag unchanged; a ValueError, not collectively."""
    if not isinstance(given, str):
        return check_tag(argument, given)
    names = names_of(tags)
    if not names:
        raise ValueError(
            f"{argument} is {given!r}: these tags have no names; give the tag, an integer, or name "
            f"them, dolfinx_mortar.Tags(tags, {{{given!r}: tag}})."
        )
    if given not in names:
        near = get_close_matches(given, names, n=1, cutoff=0.5)
        guess = f"; did you mean {near[0]!r}?" if near else "."
        raise ValueError(
            f"{argument} is {given!r}: no such name{guess} There are "
            f"{', '.join(f'{name!r} ({tag})' for name, tag in names.items())}."
        )
    return names[given]


def by_tag(tags: Any, given: Mapping[Any, Value], argument: str) -> dict[Any, Value]:
    """Dictionary by tag; a ValueError for unknown and repeated names."""
    found: dict[Any, Value] = {}
    for key, value in given.items():
        tag = tag_of(tags, key, f"{argument}: the key")
        if tag in found:
            raise ValueError(
                f"{argument} has {label(tags, tag)} twice, by its name and by its tag."
            )
        found[tag] = value
    return found


def names_of(tags: Any) -> Mapping[str, int]:
    """Names of tags, empty for others."""
    return tags.names if isinstance(tags, Tags) else {}


def label(tags: Any, tag: Any) -> str:
    """Tag's name in quotes, or its number, for messages."""
    return next((repr(name) for name, of in names_of(tags).items() if of == tag), str(tag))


def labels(tags: Any, chosen: Iterable[Any]) -> str:
    """Several tags with names and numbers, for messages."""
    names = {tag: f"{name!r} ({tag})" for name, tag in names_of(tags).items()}
    return ", ".join(names.get(tag, str(tag)) for tag in chosen)


def all_labels(comm: MPI.Comm, tags: Any) -> str:
    """All tags of all ranks with names and numbers, for messages; collective."""
    every = comm.allgather([*names_of(tags).values(), *tags.values.tolist()])
    return labels(tags, sorted({tag for own in every for tag in own}))
