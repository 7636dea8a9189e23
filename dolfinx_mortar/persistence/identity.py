# SPDX-License-Identifier: MIT
"""The identity of a problem, independent of ranks, by which a checkpoint is matched with it.

Loads, supports and other data that a program sets before each step are not part of it.
"""

from collections.abc import Mapping
from numbers import Real
from typing import Any

from mpi4py import MPI

import numpy as np

from dolfinx import fem
from dolfinx_mortar import compat
from dolfinx_mortar.arguments import as_numbers
from dolfinx_mortar.arrays import SAME, Floats, Ints
from dolfinx_mortar.materials.ranges import named_parameters
from dolfinx_mortar.persistence.committed import ProblemState
from dolfinx_mortar.solid.solid import Solid

VARYING = "changing"
Identity = Mapping[str, Mapping[str, Any]]  # value by name by subject, of what JSON can hold


def describe(state: ProblemState) -> dict[str, dict[str, Any]]:
    """Return the identity of a problem; collective.

    Numbers of cells and nodes, degrees, kinematics, geometry, terms with a state, interfaces, and
    of every material its law, its parameters and internal variables, and how many cells it has. A
    law is known by its name: changes of its code are not seen, nor are the values of parameters
    that may change between steps.
    """
    solid, V = state.solid, state.solid.V
    domain, cells = V.mesh, V.mesh.topology.index_map(V.mesh.topology.dim)
    parts = _parts(solid)
    names = [name for name, _ in state.terms]
    states = zip(names, state.ask_terms("state"), strict=True)
    own = [int((part < cells.size_local).sum()) for _, part in parts]
    counts = domain.comm.allreduce(np.array(own, dtype=int), op=MPI.SUM).tolist()
    identity: dict[str, dict[str, Any]] = {
        "mesh": {
            "dimension": domain.geometry.dim,
            "cell": domain.topology.cell_name(),
            "degree": compat.cell_degree(domain),
            "cells": cells.size_global,
        },
        "displacement": {
            "degree": V.element.basix_element.degree,
            "nodes": V.dofmap.index_map.size_global,
        },
        "solid": {
            "kinematics": solid.kinematics.name,
            "quadrature_degree": solid.quadrature_degree,
            "volumetric": solid.volumetric,
            "materials": ", ".join(type(material).__name__ for material, _ in parts),
        },
        "problem": {
            "geometry": state.geometry,
            "interfaces": ", ".join(map(repr, state.interfaces)),
            "terms": [
                f"{name}: {', '.join(sorted(map(_column, found.items())))}"
                for name, found in states
                if found
            ],
        },
    } | {
        f"material {k}, {type(material).__name__}": _describe_material(material) | {"cells": count}
        for k, ((material, _), count) in enumerate(zip(parts, counts, strict=True))
    }
    of_parts = dict(zip(names, state.ask_terms("identity"), strict=True))
    for k, interface in enumerate(state.interfaces):
        if interface.rigid is not None:
            of_parts[f"interfaces[{k}], {interface!r}"] = interface.rigid.identity
    return identity | {subject: own for subject, own in of_parts.items() if own}


def _column(state: tuple[str, fem.Function]) -> str:
    """Return name and size of a state of a term."""
    name, f = state
    return f"{name} ({f.function_space.dofmap.bs})"


def _parts(solid: Solid) -> list[tuple[Any, Ints]]:
    """Return the materials with their local cells."""
    return [part for region in solid.regions for part in region.parts]


def _describe_material(material: Any) -> dict[str, Any]:
    """Return parameters and internal variables of a material."""
    parameters = named_parameters(material).items()
    numbers = {n: float(v) if isinstance(v, Real) else VARYING for n, v in parameters}
    return numbers | {"state": {n: list(shape) for n, shape in sorted(material.state.items())}}


def material_numbers(solid: Solid) -> Floats:
    """Return the number of the material (points, 1) at the owned integration points."""
    dofmap = solid.stress.function_space.dofmap
    numbers = np.zeros((dofmap.index_map.size_local + dofmap.index_map.num_ghosts, 1))
    for k, (_, cells) in enumerate(_parts(solid)):
        numbers[dofmap.list[cells].ravel()] = k
    return numbers[: dofmap.index_map.size_local]


def differences(saved: Identity, present: Identity) -> list[str]:
    """Return in words how the problem of a checkpoint differs from the present one.

    Args:
        saved: what `describe` has returned for that problem.
        present: the same for this one.
    """
    return [
        f"{subject}: {name} {told}"
        for subject in {**present, **saved}
        for old, new in [(saved.get(subject, {}), present.get(subject, {}))]
        for name in {**old, **new}
        if (told := _difference(old.get(name, "missing"), new.get(name, "missing")))
    ]


def _difference(before: Any, now: Any) -> str:
    """Say how a value differs from that of a checkpoint; lists of numbers beyond round-off."""
    a, b = as_numbers(before), as_numbers(now)
    if isinstance(now, list) and a is not None and b is not None and a.shape == b.shape:
        off = float(np.abs(a - b).max(initial=0.0))
        same = off <= SAME * np.abs(b).max(initial=0.0)
        return "" if same else f"is off by up to {off:.3g} from the checkpoint"
    return "" if before == now else f"is {now!r}, in the checkpoint {before!r}"
