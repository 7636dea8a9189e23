# SPDX-License-Identifier: MIT
"""All interfaces of a problem: pairs of facets, owners of slave nodes, couplings, and one T."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cached_property

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from dolfinx import fem
from dolfinx_mortar.algebra.parallel import any_rank, is_ours, maximum
from dolfinx_mortar.common.arrays import Bools, Floats, Ints
from dolfinx_mortar.common.spaces import with_ghosts, with_values
from dolfinx_mortar.interfaces.basis import (
    Claims,
    Transformation,
    are_outdated,
    notes_on_splits,
    resolve_claims,
)
from dolfinx_mortar.interfaces.constraints import (
    Constraints,
    SlipLimits,
    join,
)
from dolfinx_mortar.interfaces.coupling import (
    Coupling,
    Pattern,
    Sides,
    with_offset,
)
from dolfinx_mortar.interfaces.interface import (
    Interface,
    full_coverage,
)
from dolfinx_mortar.interfaces.link import Link
from dolfinx_mortar.interfaces.moving_geometry import GeometryTangent
from dolfinx_mortar.interfaces.slip_partners import Partners
from dolfinx_mortar.interfaces.tie import Bolt
from dolfinx_mortar.interfaces.tool import Tool
from dolfinx_mortar.mortar.common_normals import find_spreads
from dolfinx_mortar.mortar.pairing import Pairing, Weight, outside_margin
from dolfinx_mortar.mortar.passing import Middles
from dolfinx_mortar.mortar.surface import (
    Boundary,
    Surface,
    coordinates,
    find_boundary,
    mean_facet_length,
)


@dataclass(frozen=True)
class Configuration:
    """All interfaces at given positions."""

    links: Sequence[Link] = ()
    claims: Claims = field(default_factory=Claims)
    transformation: Transformation | None = None
    paired_at: Floats = field(default_factory=lambda: np.zeros(0))  # (n,) displacement; empty for X

    def largest_slip(self, u: PETSc.Vec) -> float:
        """Largest deviation of ties from their jumps; collective."""
        missed = [link.missed(u)[link.constrained] for link in self.links if not link.unilateral]
        largest = np.abs(np.concatenate([np.zeros(0), *missed])).max(initial=0.0)
        return float(maximum(u.comm.tompi4py(), largest)[0])


@dataclass(frozen=True)
class Reused:
    """Last search and T, whose matrices are reused where their patterns fit."""

    pairs: Sequence[tuple[Pairing | None, Pattern]] = ()
    claims: Claims = field(default_factory=Claims)
    at_X: dict[int, Coupling] = field(default_factory=dict)
    paired_at: Floats = field(default_factory=lambda: np.zeros(0))
    transformation: Transformation | None = None
    moving: GeometryTangent | None = None


class InterfaceSystem:
    """Interfaces of a problem, and their present configuration.

    Args:
        interfaces: in the order in which they claim slave nodes.
        fixed: (local nodes, d) prescribed directions.
        weight: factor of all integrals, None for 1.

    Attributes:
        present: configuration in use.
        searches: number of pairings.
        middles: mid-surface points of both sides of each contact.
        faced: whether the sides have faced each other, and may turn away.
        facet_length: largest mean slave facet, 1 without interfaces.
    """

    def __init__(
        self,
        V: fem.FunctionSpace,
        interfaces: Sequence[Interface],
        fixed: Bools,
        weight: Weight | None = None,
    ) -> None:
        self.V, self.interfaces = V, list(interfaces)
        self.sides: list[Sides] = [i.find_sides(V, fixed, weight) for i in interfaces]
        two = [sides.unilateral and sides.master is not None for sides in self.sides]
        if any(two):
            contacts, ties = (
                [part for one in self.sides if one.unilateral is opens for part in one.surfaces]
                for opens in (True, False)
            )
            mirrors = np.any([sides.mirrors for sides in self.sides if sides.unilateral], axis=0)
            columns = [with_ghosts(V, column) for column in mirrors[: self.n].T]
            spreads = find_spreads(self.boundary, contacts, ties, np.stack(columns, axis=1))
            self.sides = [
                replace(sides, spreads=spreads) if some else sides
                for sides, some in zip(self.sides, two, strict=True)
            ]
        self.facet_length = max((mean_facet_length(s.slave) for s in self.sides), default=1.0)
        self.present = Configuration()
        self._reused = Reused()
        self.searches = 0
        self.middles: list[tuple[Middles, ...]] | None = None
        self.faced = False

    @property
    def n(self) -> int:
        """Number of owned nodes."""
        return int(self.V.dofmap.index_map.size_local)

    @property
    def links(self) -> Sequence[Link]:
        """Present interfaces."""
        return self.present.links

    @property
    def unilateral(self) -> list[Link]:
        """Links with one-sided bounds."""
        return [link for link in self.links if link.unilateral]

    @property
    def opposite(self) -> list[tuple[Surface, ...]]:
        """Sides that may pass through each other or a tool."""
        return [
            tuple(sides.surfaces) if sides.unilateral and (sides.master or interface.tool) else ()
            for interface, sides in zip(self.interfaces, self.sides, strict=True)
        ]

    @cached_property
    def boundary(self) -> Boundary:
        """All exterior facets of this rank; collective at first."""
        return find_boundary(self.V)

    @property
    def can_open(self) -> Bools:
        """Owned nodes (n,) of contacts."""
        marks = np.zeros(self.n, dtype=bool)
        for side in self.sides:
            if side.unilateral:
                marks |= (side.on_slave | side.on_master)[: self.n]
        return marks

    def tools_at(self, u: fem.Function) -> list[tuple[Tool, Floats]]:
        """Tools, with boxes (2, d) of sides; collective."""
        tools = []
        for interface, sides in zip(self.interfaces, self.sides, strict=True):
            if interface.tool is None:
                continue
            x = interface.tool.pose().to_tool(coordinates(sides.slave, u))
            ends = np.concatenate([-x, x]).reshape(2, *x.shape).max(axis=1, initial=-np.inf)
            low, high = maximum(self.V.mesh.comm, *ends.ravel()).reshape(2, -1)
            tools.append((interface.tool, np.stack([-low, high])))
        return tools

    @property
    def transformation(self) -> Transformation | None:
        """Present T; None without interfaces."""
        return self.present.transformation

    def link(self, interface: Interface) -> Link:
        """Present link of an interface."""
        return next(link for link in self.links if link.interface is interface)

    def at(self, u: fem.Function | None) -> Configuration:
        """Pair and couple the surfaces at X + u, without T; collective."""
        if not self.interfaces:
            return Configuration()
        at = self._pair(u)
        return Configuration(self._coupled(u), self._reused.claims, paired_at=at)

    def _pair(self, u: fem.Function | None) -> Floats:
        self.searches += 1
        every = list(zip(self.interfaces, self.sides, strict=True))
        at = [None if interface.stays else u for interface in self.interfaces]
        unknown: list[tuple[Pairing | None, Pattern] | None] = [None] * len(every)
        earlier = self._reused.pairs or unknown
        found = [
            interface.pair(sides, v, again=self.faced, earlier=known)
            for (interface, sides), v, known in zip(every, at, earlier, strict=True)
        ]
        self.faced = True
        coverage = [full_coverage(self.sides[0])]
        if len(every) > 1:
            coverage = [
                interface.measure_coverage(sides, pairing, v)
                for (interface, sides), (pairing, _), v in zip(every, found, at, strict=True)
            ]
        patterns = [pattern for _, pattern in found]
        claims = resolve_claims(self.interfaces, self.sides, patterns, coverage)
        notes = notes_on_splits(self.interfaces, self.sides, coverage, at)
        claims = replace(claims, notes=[*claims.notes, *notes])
        where = np.zeros(0) if u is None else u.x.array[: self.n * self.V.dofmap.bs].copy()
        self._reused = replace(self._reused, pairs=found, claims=claims, at_X={}, paired_at=where)
        return where

    def _coupled(self, u: fem.Function | None) -> list[Link]:
        """Couple all at X + u, ties and frozen contacts once per search."""
        links, reused = [], self._reused
        every = zip(self.interfaces, self.sides, reused.pairs, reused.claims.banned, strict=True)
        for k, (interface, sides, (pairing, pattern), banned) in enumerate(every):
            at = None if interface.stays else u
            lasts = at is None and pairing is not None and is_ours(interface)
            found = reused.at_X.get(k) if lasts else None
            if found is None:
                found = interface.couple(sides, pairing, pattern, banned, at)
            if lasts:
                reused.at_X[k] = found
            if sides.unilateral:
                found = with_offset(
                    found, sides, pattern, interface.apart(self.V, sides.slave.nodes)
                )
            links.append(Link(sides, pairing, pattern, found, banned, interface))
        return links

    def near(self, u: fem.Function | None) -> Configuration:
        """Couple the last pairs at X + u, or new ones where they do not fit; collective."""
        reused = self._reused
        slid = [
            outside_margin(pairing, u)
            for interface, (pairing, _) in zip(self.interfaces, reused.pairs, strict=True)
            if u is not None and pairing is not None and not interface.stays
        ]
        if self.interfaces and not any(slid):
            links = self._coupled(u)
            if not are_outdated(reused.claims, links):
                return Configuration(links, reused.claims, paired_at=reused.paired_at)
        return self.at(u)

    def begin(self, u: fem.Function | None, known: Floats | None) -> Configuration:
        """First configuration of a step at X + u (X for None), without T; collective.

        Paired at the committed displacement `known` (n,) while that fits, empty for X, or at X + u
        for None.
        """
        if known is None or not self.interfaces:
            return self.at(u)
        at = self._reused.paired_at
        same = len(self._reused.pairs) > 0 and np.array_equal(at, known)
        if not self.V.mesh.comm.allreduce(same, op=MPI.LAND):
            self._pair(None if u is None else with_values(self.V, known))
        return self.near(u)

    def follow(self, u: fem.Function | None) -> bool:
        """Update to X + u (X for None) in a step; whether T is new; collective."""
        return self.enter(self.near(u))

    def enter(self, found: Configuration) -> bool:
        """Make a configuration the present one; whether T is new; collective."""
        links, claims, reused = found.links, found.claims, self._reused
        if not links:
            self.present = found
            return False
        T = reused.transformation
        same = T is not None and T.serves(links, claims)
        if T is None or not self.V.mesh.comm.allreduce(same, op=MPI.LAND):
            self.present = Configuration()  # free the memory for the new T
            self._reused = replace(reused, transformation=None, moving=None)
            T = Transformation(self.V, links, claims)
            self._reused = replace(self._reused, transformation=T)
        T.update(links)
        self.present = replace(found, transformation=T)
        return T is not reused.transformation

    @contextmanager
    def put_back(self) -> Iterator[None]:
        """Restore the present configuration after the block; collective."""
        present, reused = self.present, self._reused
        try:
            yield
        finally:  # perhaps on this rank only: no communication
            if present.transformation is not None:
                self.present, self._reused = present, reused
        if present.transformation is not None:
            present.transformation.update(present.links)  # the block may have refilled it

    def linearise_geometry(
        self,
        u: fem.Function,
        multipliers: Floats,
        tangential: Floats | None,
        slips: tuple[PETSc.Vec, Sequence[Partners | None]],
    ) -> GeometryTangent:
        """Derivatives of the moving geometry at X + u; collective.

        `slips` are the displacement since the last commit, and the partners; others as in
        `LinkDerivatives`.
        """
        T, moving = self.transformation, self._reused.moving
        assert T is not None
        lacks = moving is None or not moving.serves(self.links)
        if moving is None or any_rank(self.V.mesh.comm, lacks)[0]:
            moving = GeometryTangent(self.V, self.links, T.claims)
            self._reused = replace(self._reused, moving=moving)
        moving.linearise(self.links, u, multipliers, tangential, slips)
        return moving

    def constraints(self, x: PETSc.Vec, u: PETSc.Vec) -> Constraints:
        """Bounds of all interfaces on increments of y, at x = X + u, also frozen; collective."""
        parts = []
        for link in self.links:
            slip = link.relative(x) if link.unilateral else link.missed(u)
            slip[:, 0] += link.coupling.heights
            at = link.nodes, link.constrained, slip, link.coupling.weight
            parts.append(link.interface.constraints(*at))
        none: Floats = np.zeros(0)
        found = join([*parts, Constraints(np.zeros(0, dtype=np.int32), none, none, none)])
        return replace(found, dofs=found.dofs.astype(np.int32))

    @property
    def driven(self) -> bool:
        """Whether loads drive tools or rigid sides."""
        offered = [interface.driven() for interface in self.interfaces]
        return any(one is not None and not isinstance(one, Bolt) for one in offered)

    @property
    def has_friction(self) -> bool:
        """Whether some contact has friction."""
        return any(interface.law is not None for interface in self.interfaces)

    def slip_limits(
        self,
        moved: PETSc.Vec,
        limits: Sequence[Floats | None],
        partners: Sequence[Partners | None],
        sliding: Floats | None = None,
    ) -> SlipLimits | None:
        """Limits of friction, or None; collective.

        Args:
            moved: (n,) displacement since the last commit.
            limits: (owned nodes,) of each interface, or None.
            partners: at the start of the step, None for present ones.
            sliding: (owned nodes, d) directions of slip at the last commit.
        """
        parts = []
        for link, limit, partner in zip(self.links, limits, partners, strict=True):
            if limit is not None:
                parts.append(link.slip_limits(limit, moved, partner, sliding))
        return join(parts) if parts else None

    def exert(self, forces: Floats) -> Floats:
        """Nodal forces on both sides of forces (owned nodes, d); collective."""
        total = np.zeros_like(forces)
        for link in self.unilateral:
            slave, master = link.exert(np.where(link.constrained[:, :1], forces[link.nodes], 0.0))
            total += slave + master
        return total

    def slots(self) -> Ints:
        """Unknown (owned nodes, d) of each node that is a Cartesian component."""
        d = self.V.dofmap.index_map_bs
        slot: Ints = np.tile(np.arange(d, dtype=np.int32), (self.n, 1))
        for link in self.links:
            carries = link.constrained.any(axis=1)
            nodes, own = link.nodes[carries], link.coupling.slot[carries]
            slot[nodes] = np.where(own >= 0, own, slot[nodes])
        return slot
