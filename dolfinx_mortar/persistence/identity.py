# SPDX-License-Identifier: MIT
"""The identity of a problem, independent of ranks, by which a checkpoint is matched with it.

Loads, supports and whatever else a program sets anew are not part of it.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from numbers import Real
from typing import Any

from mpi4py import MPI

import numpy as np

from dolfinx import mesh
from dolfinx_mortar import compat
from dolfinx_mortar.arrays import Ints
from dolfinx_mortar.persistence.lasting import Lasting

# Of the largest coordinate: by so much the means of cells may differ. Sums of a million midpoints
# lose less.
SAME_MEAN = 1e-9
VARYING = "changing"


def describe(lasting: Lasting) -> dict[str, Any]:
    """Return the identity of a problem as JSON; collective.

    Numbers of cells and nodes, degrees, kinematics, geometry, terms with a state, interfaces, and
    of every material its law, its parameters and internal variables, and how many cells it has, and
    where. A law is known by its name: changes of its code are not seen, nor are the values of
    parameters that may change between steps.
    """
    solid, V = lasting.solid, lasting.solid.V
    stateful = [(name, term) for name, term in lasting.terms if term.state]
    domain, imap = V.mesh, V.mesh.topology.index_map(V.mesh.topology.dim)
    return {
        "mesh": {
            "dimension": domain.geometry.dim,
            "cell": domain.topology.cell_name(),
            "degree": compat.cell_degree(domain),
            "cells": imap.size_global,
        },
        "displacement": {
            "degree": V.element.basix_element.degree,
            "nodes": V.dofmap.index_map.size_global,
        },
        "solid": {
            "kinematics": solid.kinematics.name,
            "quadrature_degree": solid.quadrature_degree,
            "volumetric": solid.volumetric,
        },
        "problem": {
            "geometry": lasting.geometry,
            "terms": [f"{name}: {', '.join(sorted(term.state))}" for name, term in stateful],
        },
        "interfaces": [repr(interface) for interface in lasting.interfaces],
        "materials": [
            _material(domain, material, cells)
            for region in solid.regions
            for material, cells in region.parts
        ],
    }


def _material(domain: mesh.Mesh, material: Any, cells: Ints) -> dict[str, Any]:
    """Return the identity of a material and its cells; collective."""
    tdim, d = domain.topology.dim, domain.geometry.dim
    own = cells[cells < domain.topology.index_map(tdim).size_local]
    count = domain.comm.allreduce(len(own), op=MPI.SUM)
    total = mesh.compute_midpoints(domain, tdim, own).sum(axis=0)[:d]
    total = domain.comm.allreduce(total, op=MPI.SUM)
    parameters = {f.name: getattr(material, f.name) for f in dataclasses.fields(material)}
    return {
        "law": type(material).__name__,
        "parameters": {
            n: float(v) if isinstance(v, Real) else VARYING for n, v in parameters.items()
        },
        "state": {name: list(shape) for name, shape in sorted(material.state.items())},
        "cells": count,
        "center": (total / max(count, 1)).tolist(),
    }


def differences(saved: Mapping[str, Any], present: Mapping[str, Any]) -> list[str]:
    """Return in words how the problem of a checkpoint differs from the present one.

    Args:
        saved: what `describe` has returned for that problem.
        present: the same for this one.
    """
    found = []
    for group in ("mesh", "displacement", "solid", "problem"):
        found += _compare(group, saved[group], present[group])
    found += _compare_lists("interfaces", saved["interfaces"], present["interfaces"])
    old, new = saved["materials"], present["materials"]
    laws = [[material["law"] for material in materials] for materials in (old, new)]
    if laws[0] != laws[1]:
        return [*found, *_compare_lists("materials", *laws)]
    for one, other in zip(old, new, strict=True):
        name = f"material {other['law']}"
        found += _compare(name, one["parameters"], other["parameters"])
        for key in ("state", "cells"):
            found += _compare(name, {key: one[key]}, {key: other[key]})
    return found


def other_places(saved: Mapping[str, Any], present: Mapping[str, Any], size: float) -> list[str]:
    """Return in words which materials have as many cells of the same mesh, but others.

    Args:
        saved: what `describe` has returned for the problem of the checkpoint.
        present: the same for this one.
        size: largest coordinate of the mesh.
    """
    return [
        f"material {new['law']}: its cells lie around {_point(new['center'])}, in the checkpoint "
        f"around {_point(old['center'])}"
        for old, new in zip(saved["materials"], present["materials"], strict=True)
        if not np.allclose(old["center"], new["center"], rtol=0.0, atol=SAME_MEAN * size)
    ]


def _compare(name: str, saved: Mapping[str, Any], present: Mapping[str, Any]) -> list[str]:
    """Return in words which entries differ."""
    return [
        f"{name}: {key} is {present.get(key, 'missing')!r}, in the checkpoint "
        f"{saved.get(key, 'missing')!r}"
        for key in {**saved, **present}
        if saved.get(key) != present.get(key)
    ]


def _compare_lists(name: str, saved: Sequence[str], present: Sequence[str]) -> list[str]:
    """Return in words how lists differ, if they do."""
    if list(saved) == list(present):
        return []
    return [
        f"{name}: {', '.join(present) or 'none'}, in the checkpoint {', '.join(saved) or 'none'}"
    ]


def _point(x: Any) -> str:
    return "(" + ", ".join(f"{v:.6g}" for v in x) + ")"
