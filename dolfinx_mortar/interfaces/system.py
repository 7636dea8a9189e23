# SPDX-License-Identifier: MIT
"""All interfaces of a problem: pairs of facets, owners of slave nodes, couplings, and one T."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from dolfinx import fem
from dolfinx_mortar.algebra.parallel import any_rank, is_ours, maximum
from dolfinx_mortar.arrays import Bools, Floats, Ints
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
    join_limits,
)
from dolfinx_mortar.interfaces.coupling import (
    Coupling,
    Pattern,
    Sides,
    with_ghosts,
)
from dolfinx_mortar.interfaces.interface import (
    Interface,
    full_coverage,
)
from dolfinx_mortar.interfaces.link import Link
from dolfinx_mortar.interfaces.moving_geometry import GeometryTangent, MovingGeometry
from dolfinx_mortar.interfaces.pretension import Bolt
from dolfinx_mortar.interfaces.slip_partners import Partners
from dolfinx_mortar.interfaces.tool import Outline
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
from dolfinx_mortar.spaces import with_values


@dataclass(frozen=True)
class Configuration:
    """All interfaces at given positions."""

    links: Sequence[Link] = ()
    claims: Claims | None = None
    transformation: Transformation | None = None
    paired_at: Floats = field(default_factory=lambda: np.zeros(0))  # (n,) displacement; empty for X

    def largest_slip(self, u: PETSc.Vec) -> float:
        """Largest deviation of ties from their jumps; collective."""
        missed = [link.missed(u)[link.constrained] for link in self.links if not link.unilateral]
        largest = np.abs(np.concatenate([np.zeros(0), *missed])).max(initial=0.0)
        return float(maximum(u.comm.tompi4py(), largest)[0])

    def partners(self, x: PETSc.Vec, *, frozen: bool) -> list[Partners | None]:
        """See `Link.partners`; collective."""
        return [link.partners(x, frozen=frozen) for link in self.links]


@dataclass(frozen=True)
class Reused:
    """Last search and T, whose matrices are reused where their patterns fit."""

    pairs: Sequence[tuple[Pairing | None, Pattern]] = ()
    claims: Claims | None = None
    at_X: Mapping[int, Coupling] = field(default_factory=dict)
    paired_at: Floats | None = None
    transformation: Transformation | None = None
    held: Sequence[Any] = ()  # of its pattern, see `_pattern_of`
    moving: MovingGeometry | None = None


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
        self._find_spreads()
        self.facet_length = max((mean_facet_length(s.slave) for s in self.sides), default=1.0)
        self.present = Configuration()
        self._reused = Reused()
        self.searches = 0
        self.middles: list[tuple[Middles, ...]] | None = None
        self.faced = False

    def _find_spreads(self) -> None:
        two = [sides.unilateral and sides.master is not None for sides in self.sides]
        if not any(two):
            return
        contacts, ties = (
            [surface for one in self.sides if one.unilateral is opens for surface in one.surfaces]
            for opens in (True, False)
        )
        mirrors = np.any([sides.mirrors for sides in self.sides if sides.unilateral], axis=0)
        columns = [with_ghosts(self.V, column) for column in mirrors[: self.n].T]
        spreads = find_spreads(self.boundary, contacts, ties, np.stack(columns, axis=1))
        self.sides = [
            replace(sides, spreads=spreads) if some else sides
            for sides, some in zip(self.sides, two, strict=True)
        ]

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
    def contacts(self) -> list[Interface]:
        """Interfaces that can open."""
        return [interface for interface in self.interfaces if interface.unilateral]

    @property
    def ties(self) -> list[Interface]:
        """Interfaces that cannot open."""
        return [interface for interface in self.interfaces if not interface.unilateral]

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
    def tied(self) -> list[tuple[Bools, Bools]]:
        """Marks (local nodes,) of both sides of each tie."""
        ties = [s for s in self.sides if not s.unilateral and s.master]
        return [(s.on_slave, s.on_master) for s in ties]

    @property
    def can_open(self) -> Bools:
        """Nodes (local nodes,) of contacts."""
        layout = self.V.dofmap.index_map
        marks = np.zeros(layout.size_local + layout.num_ghosts, dtype=bool)
        for side in self.sides:
            if side.unilateral:
                marks |= side.on_slave | side.on_master
        return marks

    def tools_at(self, u: fem.Function) -> list[tuple[Outline, Floats]]:
        """Outlines of tools, with boxes (2, d) of sides; collective."""
        tools = []
        for interface, sides in zip(self.interfaces, self.sides, strict=True):
            if interface.tool is None:
                continue
            tool = interface.tool.outline()
            x = tool.pose.to_tool(coordinates(sides.slave, u))
            ends = np.concatenate([-x, x]).reshape(2, *x.shape).max(axis=1, initial=-np.inf)
            low, high = maximum(self.V.mesh.comm, *ends.ravel()).reshape(2, -1)
            tools.append((tool, np.stack([-low, high])))
        return tools

    @property
    def transformation(self) -> Transformation | None:
        """Present T; None without interfaces."""
        return self.present.transformation

    @property
    def notes(self) -> list[str]:
        """Notes on multipliers removed by the present claims."""
        return [] if self.present.claims is None else list(self.present.claims.notes)

    def link(self, interface: Interface) -> Link:
        """Present link of an interface."""
        return self.links[next(k for k, i in enumerate(self.interfaces) if i is interface)]

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
        claims = replace(claims, notes=claims.notes + notes)
        where = np.zeros(0) if u is None else u.x.array[: self.n * self.V.dofmap.bs].copy()
        self._reused = replace(self._reused, pairs=found, claims=claims, at_X={}, paired_at=where)
        return where

    def _coupled(self, u: fem.Function | None) -> list[Link]:
        links, claims = [], self._reused.claims
        assert claims is not None
        for k, (interface, sides) in enumerate(zip(self.interfaces, self.sides, strict=True)):
            parts = sides, *self._reused.pairs[k], claims.banned[k]
            coupling = self._couple(k, parts, u)
            links.append(Link(*parts[:3], coupling, claims.banned[k], interface))
        return links

    def _couple(
        self,
        k: int,
        parts: tuple[Sides, Pairing | None, Pattern, Bools],
        u: fem.Function | None,
    ) -> Coupling:
        """Couple interface k at X + u, ties and frozen contacts once per search."""
        interface, reused = self.interfaces[k], self._reused
        at = None if interface.stays else u
        lasts = at is None and parts[1] is not None and is_ours(interface)
        if lasts and k in reused.at_X:
            return reused.at_X[k]
        found = interface.couple(*parts, at)
        if lasts:
            self._reused = replace(reused, at_X={**reused.at_X, k: found})
        return found

    def _followed(self, k: int, link: Link, u: fem.Function | None) -> Link:
        if u is not None and link.interface.stays and link.pairing and is_ours(link.interface):
            return link
        parts = link.sides, link.pairing, link.pattern, link.banned
        return replace(link, coupling=self._couple(k, parts, u))

    def begin(self, u: fem.Function | None, known: Floats | None) -> Configuration:
        """First configuration of a step at X + u (X for None), without T; collective.

        Paired at the committed displacement `known` (n,) while that fits, empty for X, or at X + u
        for None.
        """
        if known is None or not self.interfaces:
            return self.at(u)
        same = self._reused.paired_at is not None and np.array_equal(self._reused.paired_at, known)
        if not self.V.mesh.comm.allreduce(same, op=MPI.LAND):
            self._pair(None if u is None else with_values(self.V, known))
        if self._slid(u):
            return self.at(u)
        links, claims = self._coupled(u), self._reused.claims
        assert claims is not None
        if are_outdated(claims, links):
            return self.at(u)
        return Configuration(links, claims, paired_at=known)

    def follow(self, u: fem.Function | None) -> bool:
        """Update to X + u (X for None) in a step; whether T is new; collective."""
        before = self.present
        if not self.interfaces:
            return False
        if self._slid(u):
            return self.enter(self.at(u))
        links = [self._followed(k, link, u) for k, link in enumerate(before.links)]
        assert before.claims is not None and before.transformation is not None
        if are_outdated(before.claims, links):
            return self.enter(self.at(u))
        before.transformation.update(links)
        self.present = replace(before, links=links)
        return False

    def enter(self, found: Configuration) -> bool:
        """Make a configuration the present one; whether T is new; collective."""
        links, claims, held = found.links, found.claims, _pattern_of(found.links)
        if claims is None:  # no interfaces
            self.present = found
            return False
        reused, T = self._reused, self._reused.transformation
        same = T is not None and T.serves(claims) and len(held) == len(reused.held)
        same = same and all(map(np.array_equal, held, reused.held))
        if T is None or not self.V.mesh.comm.allreduce(same, op=MPI.LAND):
            self.present = Configuration()  # free the memory for the new T
            self._reused = replace(reused, transformation=None, moving=None)
            T = Transformation(self.V, links, claims)
            self._reused = replace(self._reused, transformation=T, held=held)
        T.update(links)
        self.present = replace(found, transformation=T)
        return T is not reused.transformation

    def _slid(self, u: fem.Function | None) -> bool:
        slid = []
        for interface, (pairing, _) in zip(self.interfaces, self._reused.pairs, strict=True):
            if not interface.stays and u is not None and pairing is not None:
                slid.append(outside_margin(pairing, u))
        return any(slid)

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
            moving = MovingGeometry(self.V, self.links, T.claims)
            self._reused = replace(self._reused, moving=moving)
        return moving.linearise(self.links, u, multipliers, tangential, slips)

    def constraints(self, x: PETSc.Vec, u: PETSc.Vec) -> Constraints:
        """Bounds of all interfaces on increments of y, at x = X + u, also frozen; collective."""
        parts = []
        for link in self.links:
            slip = link.relative(x) if link.unilateral else link.missed(u)
            slip[:, 0] += link.coupling.heights
            at = link.nodes, link.constrained, slip, link.coupling.weight
            parts.append(link.interface.constraints(*at))
        none: Floats = np.zeros(0)
        return join([*parts, Constraints(np.zeros(0, dtype=np.int32), none, none, none)])

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
        return join_limits(parts) if parts else None

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


def _pattern_of(links: Sequence[Link]) -> list[Any]:
    held: list[Any] = []
    for link in links:
        held += [link.pattern.row, link.pattern.column, link.banned]
    return held
