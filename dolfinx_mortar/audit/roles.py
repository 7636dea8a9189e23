# SPDX-License-Identifier: MIT
"""Choice of the slave side of proposed contacts, and lost constraints."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np
import scipy

from dolfinx_mortar.arrays import HALF_OF_DIGITS, Floats, Longs

Cost = tuple[float, ...]
# Ratio of slave to master facets for accurate pressures. Disc on a block, moduli 1:1 to 1:1000:
# peaks are right to .7 % up to 4, to 6 % at 8, 11 % at 12; half of 4 for small patches.
COARSE = 2.0


@dataclass(frozen=True, eq=False)
class Candidates:
    """Pairs of sides that face each other; same on all ranks."""

    sides: Longs  # (p, 2) numbers of the sides
    sizes: Floats  # (p, 2) mean facet diameters
    group: Longs  # (s,) tag of each side
    common: Longs  # (s, s) shared nodes that face partners

    def __getitem__(self, which: Longs) -> "Candidates":
        """Some pairs."""
        return Candidates(self.sides[which], self.sizes[which], self.group, self.common)


@dataclass(frozen=True, eq=False)
class Roles:
    """Slave sides, and slave nodes that lose a constraint."""

    slave: Longs  # (p,) 0 or 1: index of the slave
    twice: dict[tuple[int, int], int]  # nodes that are slaves in two pairs, lost by the second
    # nodes of the second that would close a cycle with the first
    cyclic: dict[tuple[int, int], int]
    cost: Cost


def choose_roles(given: Candidates) -> Roles:
    """Roles with fine slaves and few lost constraints.

    A node is the slave in one contact only; contacts must not need each other's slave nodes in a
    cycle (`interfaces.claims`). Minimised in this order: slaves `COARSE` times coarser than their
    masters; slave faces with two masters at a node; shares of slave sides lost by cycles; shares of
    other nodes with two masters; coarseness of slaves; number of the side. (Of 150 walls 3 do not
    converge, with a choice pair by pair 9.)
    """
    slave = np.zeros(len(given.sides), dtype=np.int64)
    for which in _related(given):
        slave[which] = _search(given[which])
    return assess(given, slave)


def _links(given: Candidates) -> Longs:
    """Matrix (p, p), nonzero where roles of pairs depend on each other."""
    sides = given.sides.T
    linked = (given.common > 0) | (given.group[:, None] == given.group)
    return np.asarray(sum(linked[np.ix_(a, b)].astype(np.int64) for a in sides for b in sides))


def _related(given: Candidates) -> Iterator[Longs]:
    label = scipy.sparse.csgraph.connected_components(
        scipy.sparse.coo_array(_links(given)), directed=False
    )[1]
    for one in range(label.max(initial=-1) + 1):
        yield np.flatnonzero(label == one)


def _search(given: Candidates) -> Longs:
    """Best roles (p,) of few related pairs, good ones of many."""
    own, other = given.sizes.T
    finer = (other < own * (1.0 - HALF_OF_DIGITS)).astype(np.int64)
    count = len(finer)
    if 2**count <= count**3:  # up to nine: all choices
        turns = np.array(list(product((0, 1), repeat=count)), dtype=np.int64)
        return min((finer ^ turn for turn in turns), key=lambda slave: assess(given, slave).cost)
    slave, links = finer, scipy.sparse.csr_array(_links(given))
    reached = links @ links
    near = [np.sort(row) for row in np.split(reached.indices, reached.indptr[1:-1])]
    for _ in range(count):
        before = slave.copy()
        for k, around in enumerate(near):
            turned = slave.copy()
            turned[k] ^= 1
            costs = [assess(given[around], roles[around]).cost for roles in (turned, slave)]
            slave = turned if costs[0] < costs[1] else slave
        if (slave == before).all():
            break
    return slave


def assess(given: Candidates, slave: Longs) -> Roles:
    """Return where nodes lose a constraint with slave sides (p,).

    Example:
        A base of three nodes faces two blocks, with two nodes each, which face each other.

        >>> sides = np.array([[0, 2], [1, 3], [4, 5]])  # base and blocks, blocks
        >>> common = np.diag([2, 2, 2, 2, 2, 2])
        >>> for a, b in ((0, 1), (2, 4), (3, 5)):  # one edge node each
        ...     common[a, b] = common[b, a] = 1
        >>> some = Candidates(sides, np.ones((3, 2)), np.array([0, 0, 1, 2, 3, 4]), common)
        >>> assess(some, np.array([0, 0, 0])).twice  # the base is the slave of both blocks
        {(0, 1): 1}
        >>> assess(some, np.array([1, 1, 0])).twice  # one block is the slave of both others
        {(0, 2): 1}
        >>> assess(some, np.array([0, 1, 0])).cyclic  # each is the slave of another one
        {(0, 2): 1}
        >>> choose_roles(some).slave.tolist()
        [0, 1, 1]
    """
    p = np.arange(len(slave))
    slaves, masters = given.sides[p, slave], given.sides[p, 1 - slave]
    size = np.maximum(given.common[slaves, slaves], 1)
    shared = np.triu(given.common[np.ix_(slaves, slaves)], 1)
    straddling = shared * (given.group[slaves][:, None] == given.group[slaves])
    twice = {(int(i), int(k)): int(shared[i, k]) for i, k in np.argwhere(shared)}
    cyclic = _close_cycles(given.common[np.ix_(masters, slaves)])
    ratio = given.sizes[p, slave] / given.sizes[p, 1 - slave]
    cost = (
        float((ratio > COARSE).sum()),
        float((straddling > 0).sum()),
        sum(nodes / size[k] for (_, k), nodes in cyclic.items()),
        float(((shared - straddling) / size).sum()),
        float(np.log(ratio).clip(min=0.0).sum()),
    )
    digits = tuple(float(np.rint(part / HALF_OF_DIGITS)) for part in cost)
    return Roles(slave, twice, cyclic, digits)


def _close_cycles(needed: Longs) -> dict[tuple[int, int], int]:
    label = scipy.sparse.csgraph.connected_components(
        scipy.sparse.coo_array(needed), directed=True, connection="strong"
    )[1]
    needs: dict[int, set[int]] = {}
    removed: dict[tuple[int, int], int] = {}
    for k in np.flatnonzero(np.bincount(label)[label] > 1):
        alike = np.flatnonzero(label[:k] == label[k])
        needs[int(k)] = {int(i) for i in alike if needed[k, i]}
        for i in map(int, alike[needed[alike, k] > 0]):
            if _reaches(needs, int(k), i):
                removed[i, int(k)] = int(needed[i, k])
            else:
                needs[i].add(int(k))
    return removed


def _reaches(needs: dict[int, set[int]], start: int, end: int) -> bool:
    seen, ahead = {start}, [start]
    while ahead:
        new = needs[ahead.pop()] - seen
        seen |= new
        ahead += new
    return end in seen
