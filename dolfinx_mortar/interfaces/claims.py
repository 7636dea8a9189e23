# SPDX-License-Identifier: MIT
"""Which interface a slave node belongs to, and in which order the interfaces' bases multiply."""

from __future__ import annotations

from collections.abc import Sequence

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from dolfinx_mortar.algebra.parallel import any_rank
from dolfinx_mortar.arrays import Bools
from dolfinx_mortar.interfaces.interface import Interface


def referenced(interface: Interface) -> Bools:
    """Return which owned nodes the candidate pairs of an interface lean on; collective."""
    V, p = interface.V, interface.pattern
    layout, n = V.dofmap.index_map, interface.n_owned
    count = PETSc.Vec().createMPI((n, layout.size_global), comm=V.mesh.comm)
    columns = p.column[p.from_D.size :].astype(PETSc.IntType)
    count.setValues(columns, np.ones(len(columns)), addv=PETSc.InsertMode.ADD_VALUES)
    count.assemble()
    return np.asarray(count.array_r > 0)


def resolve_claims(interfaces: Sequence[Interface]) -> tuple[list[int], list[str]]:
    """Give every slave node to one interface and order the interfaces; collective.

    A second claim on a slave node, and a claim that would close a cycle, is removed from the later
    interface (the node's dual function is shared out, it stays on the slave side). What an earlier
    search removed counts no more: bodies that have slid lean on other nodes.

    Returns:
        The order in which the transformations multiply, and notes on what was removed.
    """
    notes: list[str] = []
    if not interfaces:
        return [], notes
    comm = interfaces[0].V.mesh.comm
    for interface in interfaces:
        interface.banned[:] = False
    claimed = np.zeros(interfaces[0].n_local, dtype=bool)
    leant_on = [referenced(interface) for interface in interfaces]
    ahead: set[tuple[int, int]] = set()  # (i, k): T_i stands left of T_k, i leans on slaves of k

    def remove(k: int, nodes: Bools, why: str) -> None:
        own = nodes[: interfaces[k].n_owned] & ~interfaces[k].banned[: interfaces[k].n_owned]
        count = comm.allreduce(int(own.sum()), op=MPI.SUM)
        if count:
            interfaces[k].banned |= interfaces[k].share(own)
            notes.append(f"{interfaces[k]}: {count} slave nodes removed, {why}")

    def leaning(i: int, k: int) -> Bools:
        """Return the owned slave nodes of k that i leans on."""
        own = slice(None, interfaces[k].n_owned)
        slaves = interfaces[k].slave_nodes[own] & ~interfaces[k].banned[own]
        # removed slave nodes enter like master nodes
        return np.asarray((leant_on[i] | interfaces[i].banned[own]) & slaves)

    for k, interface in enumerate(interfaces):
        remove(k, interface.slave_nodes & claimed, "claimed by an earlier interface")
        remove(k, leaning(k, k), "they are master nodes of the same interface")
        ahead |= {(k, i) for i in range(k) if any_rank(comm, leaning(k, i).any())[0]}
        for i in range(k):
            hit = leaning(i, k)
            if not any_rank(comm, hit.any())[0]:
                continue
            if _reaches(ahead, k, i):
                remove(k, hit, f"they would close a cycle with {interfaces[i]}")
            else:
                ahead.add((i, k))
        claimed |= interface.slave_nodes & ~interface.banned
    return _topological(len(interfaces), ahead), notes


def _reaches(edges: set[tuple[int, int]], a: int, b: int) -> bool:
    """Tell whether b can be reached from a."""
    return any(c == a and (e == b or _reaches(edges, e, b)) for c, e in edges)


def _topological(n: int, edges: set[tuple[int, int]]) -> list[int]:
    """Return 0..n-1 ordered so that every edge (i, k) has i before k."""
    order: list[int] = []
    while len(order) < n:
        order.append(
            next(
                k
                for k in range(n)
                if k not in order and all(i in order for i, e in edges if e == k)
            )
        )
    return order
