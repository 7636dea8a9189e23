# SPDX-License-Identifier: MIT
"""From the data of a random problem to the problem itself, by the public API."""

from collections.abc import Callable
from dataclasses import dataclass

from mpi4py import MPI

import numpy as np

import dolfinx_mortar as dm
from dolfinx import fem, mesh
from tests.cases.meshes_3d import two_boxes
from tests.sweep.draws import Draw, draw

COMM = MPI.COMM_WORLD


@dataclass(frozen=True)
class RandomProblem:
    """A problem with its load levels, and what is needed to check it from outside."""

    data: Draw
    problem: dm.ContactProblem
    cell_tags: mesh.MeshTags
    facet_tags: mesh.MeshTags
    sides: list[tuple[int, int]]  # slave and master tag of each contact
    bcs: list[fem.DirichletBC]
    on_time: Callable[[float], None]
    limit: fem.Function | None = None  # of friction, on the nodes of the pressure

    @property
    def levels(self):
        """Equal load steps up to the depth."""
        steps = self.data["steps"]
        return np.asarray(self.data["depth"] * np.arange(1, steps + 1) / steps)


def create(kind, seed, surface="facets"):
    """Return a random problem; collective."""
    return KINDS[kind](draw(kind, seed) | {"surface": surface})


def _hertz(data):
    m = dm.meshing.hertz(COMM, **data["mesh"])
    return _two_bodies(data, *m)


def _boxes3(data):
    def wavy(x):
        x = x.copy()
        x[:, 2] += data["wave"] * np.sin(3 * x[:, 0]) * np.cos(2 * x[:, 1])
        return x

    return _two_bodies(data, *two_boxes(COMM, transform=wavy, **data["mesh"]))


def _two_bodies(data, domain, cell_tags, facet_tags):
    """Clamp tag 1, push tag 2 down and aside, and turn it; contact is between tags 3 and 4."""
    d = domain.geometry.dim
    V = fem.functionspace(domain, ("Lagrange", data.get("degree", 1), (d,)))
    values = [fem.Constant(domain, np.zeros(d)) for _ in range(2)]
    held = [fem.locate_dofs_topological(V, d - 1, facet_tags.find(tag)) for tag in (1, 2)]
    bcs = [fem.dirichletbc(value, dofs, V) for value, dofs in zip(values, held, strict=True)]
    turn, turned = data.get("turn", 0.0), fem.Function(V)
    if turn:
        bcs[1] = fem.dirichletbc(turned, held[1])
    if data.get("kinematics") == "axisymmetric":
        W, axis = V.sub(0), facet_tags.find("axis")
        held = fem.locate_dofs_topological(W, d - 1, axis)
        bcs.append(fem.dirichletbc(fem.Constant(domain, 0.0), held, W))
    tilt, path = data["tilt"], data.get("path")
    direction = np.array([tilt, -1.0] if d == 2 else [tilt, -tilt / 2, -1.0])
    aside = 0.0 if data.get("kinematics") == "axisymmetric" else 1.0

    def on_time(t):
        values[1].value[:] = t * direction
        if path is not None:
            ends, now = np.arange(len(path) + 1), t / data["depth"] * len(path)
            x, y, z = (np.interp(now, ends, [0.0, *way]) for way in zip(*path, strict=True))
            push = (aside * x, -z * data["depth"])
            values[1].value[:] = push if d == 2 else (x, y, push[1])
        if turn:
            angle = turn * t / data["depth"]
            c, s = np.cos(angle), np.sin(angle)
            R, middle = np.array([[c, -s], [s, c]]), np.array([[0.0], [data["mesh"]["radius"]]])
            shift = values[1].value[:, None]
            turned.interpolate(lambda x: (R - np.eye(2)) @ (x[:2] - middle) + shift)

    return _with_contact(data, fem.Function(V), (cell_tags, facet_tags), bcs, on_time)


def _with_contact(
    data,
    u,
    tags,
    bcs,
    on_time,
):
    """Put one contact between the facet tags 3 and 4."""
    sides = (data["slave"], 7 - data["slave"])
    law, limit = _law_of_friction(data, u.function_space)
    options = law | {"surface": data["surface"]}
    contact = dm.Contact(tags[1], slave=sides[0], master=sides[1], **options)
    solid = dm.Solid(
        u,
        data["laws"],
        tags[0],
        kinematics=data.get("kinematics"),
        volumetric=data.get("volumetric", "full"),
        strain=data.get("strain", "small"),
    )
    problem = dm.ContactProblem(solid, [contact], bcs=bcs, geometry=data["geometry"])

    return RandomProblem(data, problem, *tags, [sides], bcs, on_time, limit)


def _law_of_friction(data, V):
    """Return the argument of the contact, and its values at the nodes; nothing without friction."""
    if "law" not in data:
        return {}, None
    name, value, given = (data["law"][key] for key in ("name", "value", "given"))
    limit = fem.Function(V.sub(0).collapse()[0])
    vary = 0.5 if given == "function" else 0.0
    limit.interpolate(lambda x: value * (1.0 + vary * np.sin(3.0 * x[0])))
    arguments = {"number": value, "constant": fem.Constant(V.mesh, value), "function": limit}
    return {name: arguments[given]}, limit


KINDS = {
    **dict.fromkeys(("hertz", "ring", "second"), _hertz),
    **dict.fromkeys(("boxes3", "second3"), _boxes3),
    **dict.fromkeys(
        ("friction", "finite"),
        lambda data: (_hertz if "kind" in data["mesh"] else _boxes3)(data),
    ),
}
