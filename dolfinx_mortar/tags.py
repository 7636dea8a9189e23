# SPDX-License-Identifier: MIT
"""Tags of cells or facets with names; for all modules."""

from collections.abc import Iterable, Mapping
from difflib import get_close_matches
from types import MappingProxyType
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

import ufl
from dolfinx import mesh
from dolfinx_mortar.arguments import Rule, check, instance, integer, is_integer
from dolfinx_mortar.arrays import Ints
from dolfinx_mortar.compat import on_same_mesh

Value = TypeVar("Value")


class Tags(mesh.MeshTags):
    """Tags of cells or facets that have names.

    They can be used wherever dolfinx's ``MeshTags`` can; names can stand for tags in this package:
    `Contact`, `Tie`, the keys of materials and eigenstrains, ``find``. UFL's measures take integers
    only: ``ds(facet_tags.tag("top"))``.

        facet_tags = dm.Tags(facet_tags, {"ball": 3, "plate": 4})

    Attributes:
        names: tag by name, in the order of the tags; not every tag needs one.
    """

    def __init__(self, tags: mesh.MeshTags, names: Mapping[str, int]) -> None:
        """Give names to tags; these are shared, or copied in the order of the entities.

        Args:
            names: tag by name, the same on all ranks.

        Raises:
            ValueError: naming a wrong argument.
        """
        check("tags", tags, instance(mesh.MeshTags, "give a dolfinx.mesh.MeshTags"))
        check("names", names, instance(Mapping, "give a dictionary, name -> tag"))
        for name, tag in names.items():
            check("names: a name", name or None, instance(str, "give a text"))
            check_tag(f"names: {name!r}", tag)
        super().__init__(in_order(tags)._cpp_object)
        self.names: Mapping[str, int] = MappingProxyType(
            {name: int(names[name]) for name in sorted(names, key=lambda name: int(names[name]))}
        )

    def tag(self, name: str | int) -> int:
        """Return the tag of a name; a tag is returned as it is.

        Raises:
            ValueError: for an unknown name; the message lists the names there are. For what is
                neither a name nor an integer of 32 bits.
        """
        tag = tag_of(self, name, "name")
        check_tag("name", tag)
        return int(tag)

    def find(self, value: int | str) -> npt.NDArray[np.int32]:
        """Return the local cells or facets (n,) that have a tag, or the tag of a name.

        Raises:
            ValueError: as in `tag`.
        """
        tag = tag_of(self, value, "value")
        check_tag("value", tag)
        return np.asarray(super().find(int(tag)))


def in_order(tags: mesh.MeshTags) -> mesh.MeshTags:
    """Return tags whose entities rise, as dolfinx assumes of facets in ``ds``; else it loses some.

    Those that do are returned as they are.
    """
    order = np.argsort(tags.indices, kind="stable")
    if (np.diff(order) == 1).all():
        return tags
    of, names = tags._cpp_object, names_of(tags)
    found = mesh.MeshTags(type(of)(of.topology, of.dim, of.indices[order], of.values[order]))
    found.name = tags.name
    return Tags(found, names) if names else found


def find_exterior(tags: mesh.MeshTags, tag: int, domain: mesh.Mesh) -> tuple[Ints, Ints]:
    """Return the owned facets that have a tag, and those of them on the boundary; collective."""
    topology = domain.topology
    topology.create_connectivity(tags.dim, topology.dim)
    marked = tags.find(tag)
    marked = marked[marked < topology.index_map(tags.dim).size_local]
    return marked, np.intersect1d(marked, mesh.exterior_facet_indices(topology))


def tags_of(domain: mesh.Mesh, dim: int) -> Rule[mesh.MeshTags]:
    """Return the rule of tags of the cells or the facets of a mesh, by their dimension."""
    sort = "cells" if dim == domain.topology.dim else "facets"

    def read(tags: Any) -> mesh.MeshTags | None:
        known = isinstance(tags, mesh.MeshTags) and tags.dim == dim
        return tags if known and on_same_mesh(tags, domain) else None

    return Rule(f"give MeshTags of the {sort} (dimension {dim}) of the same mesh", read)


def check_measures(name: str, form: ufl.Form, domain: mesh.Mesh) -> None:
    """Raise a ValueError on all ranks if a measure of a form leaves out what it names; collective.

    Dolfinx integrates over nothing where a tag has no cell or no exterior facet, or there are no
    tags, and over a part of the facets where these are not sorted.
    """
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
            known = sorted(set().union(*domain.comm.allgather({*tags.values.tolist()})))
            why = (
                "all of its facets lie inside the mesh"
                if counts[0]
                else f"no {on[:-1]} has this tag; the tags are {labels(tags, known)}"
            )
            raise ValueError(f"{measure} acts nowhere: {why}")


def check_tag(name: str, tag: Any) -> None:
    """Raise a ValueError unless the argument `name` is a value that MeshTags can hold."""
    limits = np.iinfo(np.int32)
    remedy = "give a tag, an integer of 32 bits, or its name"
    check(name, tag, integer(limits.min, limits.max), remedy)


def check_entities(name: str, tags: mesh.MeshTags) -> None:
    """Raise a ValueError if tags mark cells or facets that this rank does not have.

    Dolfinx takes any numbers; negative ones count from the end of an array.
    """
    layout = tags.topology.index_map(tags.dim)
    count = layout.size_local + layout.num_ghosts
    outside = tags.indices[(tags.indices < 0) | (tags.indices >= count)]
    if len(outside):
        raise ValueError(
            f"{name} mark the entity {outside[0]} of dimension {tags.dim}, but this rank has 0 to "
            f"{count - 1}: take them from dolfinx.mesh.locate_entities"
        )


def tag_of(tags: Any, given: Any, argument: str) -> Any:
    """Return the tag of a name; what is not a string is returned as it is, without a check.

    Args:
        tags: what the argument chooses from, a `Tags` if it has names.
        given: a name or a tag.
        argument: its name, for messages.

    Raises:
        ValueError: for a string that is no name; without communication.
    """
    if not isinstance(given, str):
        return given
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
    """Return a dictionary by name or tag as one by tag.

    Raises:
        ValueError: for a string that is no name, and a tag that is given twice.
    """
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
    """Return the names of tags, none if they have none."""
    return tags.names if isinstance(tags, Tags) else {}


def label(tags: Any, tag: Any) -> str:
    """Return the text for a tag in messages: its name in quotes, otherwise its number."""
    return next((repr(name) for name, of in names_of(tags).items() if of == tag), str(tag))


def labels(tags: Any, chosen: Iterable[Any]) -> str:
    """Return the text for several tags in messages, with names and numbers."""
    names = {tag: f"{name!r} ({tag})" for name, tag in names_of(tags).items()}
    return ", ".join(names.get(tag, str(tag)) for tag in chosen)
