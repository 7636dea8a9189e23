# SPDX-License-Identifier: MIT
"""Does a step obey the law of friction? Judged from tractions, pressures and displacements."""

from dataclasses import dataclass

from mpi4py import MPI

import numpy as np

TINY = np.finfo(float).tiny
LEAST_LIMIT = 1e-1
"""The scale of tangential tractions is the largest limit, or this share of the largest pressure.

Steps are solved to 1e-6 of their largest forces, which are normal ones: with mu = 0.009 the law of
a correct step is off by 1e-4 of mu p (seed 1). The check's 1e-4 of this scale are 1e-5 of p.
"""


@dataclass(frozen=True)
class Nodes:
    """The owned slave nodes as the check has found them."""

    nodes: np.ndarray  # (n,)
    normals: np.ndarray  # (n, d)
    loose: np.ndarray  # (n, d) directions without Dirichlet data
    acts: np.ndarray  # (n,) where contact can act
    pressure: np.ndarray  # (n,)
    value: np.ndarray  # (n,) mu or s


def residuals(contact, at, way, travel, floor, begun):
    """Return what a committed step leaves of the law |tau| <= s, slip against tau; collective.

    Coulomb's s is mu p; Tresca's acts wherever a node faces the master.

    "limit": largest |tau| - s, or part of tau along the normal, over the largest s; "slip":
    largest s |slip| + tau . slip, which is zero where it sticks, or slips with tau at its limit
    and against the slip, over the largest s and the travel; "status": largest | |tau| - s | where
    it is said to slip, over the largest s, and largest slip where it is said to stick, over the
    travel.

    Args:
        contact: with friction, solved.
        at: its nodes.
        way: (n, d) motion of the slave side relative to the master in the step; read off the
            contact if it is None.
        travel: largest motion of a node in the step.
        floor: pressures below it are round-off.
        begun: traction of the forces at the begin of the step, which its accuracy is one of: bodies
            that part (seed 79) have none left.
    """
    comm, d = contact.traction.function_space.mesh.comm, at.normals.shape[1]
    tau = contact.traction.x.array.reshape(-1, d)[at.nodes]
    if way is None:
        way = contact.step_slip.x.array.reshape(-1, d)[at.nodes]
    along = _tangential(way, at.normals, at.loose)
    coulomb = contact.law is not None and contact.law.name == "friction"
    # given friction acts at all nodes that face the master, closed or not
    acts = at.pressure > 0.0 if coulomb else ~np.isnan(contact.gap.x.array[at.nodes])
    closed = at.acts & acts
    limit = np.where(closed, at.value * (at.pressure if coulomb else 1.0), 0.0)
    size, far = np.linalg.norm(tau, axis=1), np.linalg.norm(along, axis=1)
    status = contact.status.x.array[at.nodes]
    work = np.where(closed, limit * far + (tau * along).sum(axis=1), 0.0)
    found = [
        limit,
        at.pressure,
        np.maximum(size - limit, np.abs((tau * at.normals).sum(axis=1))),
        work,
        np.where(status == 2.0, np.abs(size - limit), 0.0),
        np.where(status == 1.0, far, 0.0),
    ]
    most, pressure, over, lost, unlike, crept = (
        comm.allreduce(float(a.max(initial=0.0)), op=MPI.MAX) for a in found
    )
    force, length = max(most, LEAST_LIMIT * max(pressure, begun), floor), max(travel, TINY)
    return {
        "limit": over / force,
        "slip": lost / (force * length),
        "status": max(unlike / force, crept / length),
    }


def _tangential(way, normals, loose):
    """Return the part along the surface and normal to prescribed directions."""
    along = way - normals * (normals * way).sum(axis=1, keepdims=True)
    for k in np.flatnonzero(~loose.all(axis=1)):
        taken = np.linalg.qr(np.column_stack([normals[k], *np.eye(len(loose[k]))[~loose[k]]]))[0]
        along[k] = way[k] - taken @ (way[k] @ taken)
    return along
