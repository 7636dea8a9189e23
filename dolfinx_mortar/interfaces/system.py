# SPDX-License-Identifier: MIT
"""All interfaces of a problem together: paired, claimed, coupled, and one change of basis."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from petsc4py import PETSc

import numpy as np

from dolfinx import fem
from dolfinx_mortar.algebra.parallel import any_rank, maximum
from dolfinx_mortar.arrays import Bools, Floats, Ints
from dolfinx_mortar.interfaces.basis import Transformation
from dolfinx_mortar.interfaces.claims import Claims, are_outdated, resolve_claims
from dolfinx_mortar.interfaces.constraints import Constraints, SlipLimits, join, join_limits
from dolfinx_mortar.interfaces.contact import Contact
from dolfinx_mortar.interfaces.coupling import (
    Coupling,
    Link,
    Sides,
    couple,
    find_sides,
    has_slid,
    measure_coverage,
    pair,
    restrict,
)
from dolfinx_mortar.interfaces.interface import Interface
from dolfinx_mortar.interfaces.near import find_reach, touches_far_nodes
from dolfinx_mortar.interfaces.partners import Partners, find_partners
from dolfinx_mortar.mortar.operators import Coverage
from dolfinx_mortar.mortar.pairing import Weight
from dolfinx_mortar.mortar.passing import Middles
from dolfinx_mortar.mortar.surface import mean_facet_length


class InterfaceSystem:
    """The interfaces of a problem and T, as of the last update.

    Args:
        V: the vector space of the displacement.
        interfaces: in the order in which they claim slave nodes.
        fixed: (local nodes, d) True where a direction of a node is prescribed.
        weight: factor of all integrals over interfaces, 1 if not given.

    Attributes:
        links: the interfaces with their pairings and couplings.
        transformation: T; None without interfaces.
        searches: how often the surfaces were paired.
        middles: those of the bodies behind both sides of each contact, see `steps.passing`.
        faced: whether the sides have faced each other at some time, so that they may turn away.
        facet_length: largest mean slave facet of the interfaces, 1 without interfaces.
    """

    def __init__(
        self,
        V: fem.FunctionSpace,
        interfaces: Sequence[Interface],
        fixed: Bools,
        weight: Weight | None = None,
    ) -> None:
        """Find the surfaces; collective."""
        self.V, self.interfaces = V, list(interfaces)
        self.sides: list[Sides] = [find_sides(i, V, fixed, weight) for i in interfaces]
        self.facet_length = max((mean_facet_length(s.slave) for s in self.sides), default=1.0)
        self.links: list[Link] = []
        self.claims: Claims | None = None
        self.transformation: Transformation | None = None
        self.searches = 0
        self.middles: list[tuple[Middles, Middles] | None] | None = None  # when first asked for
        self.faced = False

    @property
    def n(self) -> int:
        """How many nodes this rank owns."""
        return int(self.V.dofmap.index_map.size_local)

    @property
    def notes(self) -> list[str]:
        """What the present claims have removed."""
        return [] if self.claims is None else list(self.claims.notes)

    def link(self, interface: Interface) -> Link:
        """Return what the last update has found for an interface."""
        return self.links[next(k for k, i in enumerate(self.interfaces) if i is interface)]

    # -- configurations --------------------------------------------------------------------------

    def update(
        self,
        at: fem.Function | None,
        x: PETSc.Vec,
        increment: float,
        *,
        search: bool = False,
        everywhere: bool = False,
        onward: bool = False,
    ) -> bool:
        """Rebuild D, M, N and T at X + u; collective.

        Args:
            at: displacement u at which normals and segments are taken; None for X.
            x: (n,) present coordinates X + u, also for frozen surfaces.
            increment: largest prescribed increment of the step, which tells what counts as near.
            search: pair the surfaces anew in any case; otherwise where they slid too far.
            everywhere: ask so for the whole surfaces, not only near the contact.
            onward: in the course of a step, which remembers who has lost a multiplier.

        Returns:
            Whether T has a new pattern.
        """
        if not self.interfaces:
            return False
        if search or not self.links or self._slid(at, everywhere=everywhere):
            self._search(at)
        else:
            self.links = [
                replace(link, coupling=self._couple(link, at, onward)) for link in self.links
            ]
            if self._claims_outdated():
                self._search(at)
        reach = find_reach(self.links, x, self.n, increment, self.facet_length)
        missing = reach.missing(self.links)
        fresh = self.transformation is None or bool(any_rank(self.V.mesh.comm, missing)[0])
        if fresh:
            assert self.claims is not None
            self.links = [restrict(link, reach.near(link)) for link in self.links]
            self.transformation = None  # before the new one needs the memory
            self.transformation = Transformation(self.V, self.links, self.claims.order)
        assert self.transformation is not None
        self.transformation.update(self.links)
        return fresh

    def _slid(self, at: fem.Function | None, *, everywhere: bool) -> bool:
        """Tell whether sides slid out of the margins of their pairings; collective."""
        slid = [
            has_slid(link, at, everywhere=everywhere)
            for link in self.links
            if link.interface.configuration(at) is not None
        ]
        return any(slid)

    def _couple(self, link: Link, at: fem.Function | None, onward: bool) -> Coupling:
        at, before = link.interface.configuration(at), link.coupling if onward else None
        parts = link.interface, link.sides, link.pairing, link.pattern, link.banned
        return couple(*parts, at, before)

    def _search(self, at: fem.Function | None) -> None:
        """Pair the surfaces and settle the claims; T has to be built anew; collective."""
        self.searches += 1
        self.transformation = None
        configurations = [i.configuration(at) for i in self.interfaces]
        found = [
            pair(interface, sides, u, again=self.faced)
            for interface, sides, u in zip(self.interfaces, self.sides, configurations, strict=True)
        ]
        self.faced = True
        pairings, patterns = zip(*found, strict=True)
        if len(self.sides) > 1:
            coverage = [
                measure_coverage(*of)
                for of in zip(self.interfaces, pairings, configurations, strict=True)
            ]
        else:  # nobody to share with
            nodes = len(self.sides[0].nodes)
            faces = np.ones(nodes, dtype=bool)
            coverage = [Coverage(np.ones(nodes), faces, ~faces)]
        self.claims = resolve_claims(self.interfaces, self.sides, patterns, coverage)
        self.links = []
        parts = zip(
            self.interfaces,
            self.sides,
            pairings,
            patterns,
            self.claims.banned,
            configurations,
            strict=True,
        )
        for interface, sides, pairing, pattern, banned, u in parts:
            coupling = couple(interface, sides, pairing, pattern, banned, u)
            near = np.ones(len(sides.nodes), dtype=bool)
            self.links.append(Link(interface, sides, pairing, pattern, coupling, near, banned))

    def _claims_outdated(self) -> bool:
        """Tell whether the claims must be settled anew; collective."""
        assert self.claims is not None
        patterns = [link.pattern for link in self.links]
        coverage = [link.coupling.coverage for link in self.links]
        return are_outdated(self.claims, self.sides, patterns, coverage)

    def is_complete(self, at: fem.Function | None, x: PETSc.Vec) -> bool:
        """Tell whether no slave node outside T may be in contact; collective.

        It may where the sides have slid past their partners, or where a gap has closed.
        """
        if not self.links:
            return True
        slid = at is not None and self._slid(at, everywhere=True)
        return not slid and not touches_far_nodes(self.links, x, self.n)

    # -- what the QP needs -----------------------------------------------------------------------

    def constraints(
        self, x: PETSc.Vec, u: PETSc.Vec, jumps: Mapping[int, PETSc.Vec] | None = None
    ) -> Constraints:
        """Return the bounds of all interfaces on increments of y; collective.

        Args:
            x: (n,) coordinates X + u (also with frozen geometry: the gap is linear in u).
            u: (n,) displacement.
            jumps: (n,) by the number of an interface: a displacement of its slave side that is no
                relative motion; none if not given.
        """
        parts = []
        for k, link in enumerate(self.links):
            slip = link.relative(_without(link.interface.measured(x, u), jumps, k))
            slip[:, 0] += link.coupling.heights
            directions = link.constrained
            parts.append(
                link.interface.constraints(link.nodes, directions, slip, link.coupling.weight)
            )
        none: Floats = np.zeros(0)
        return join([*parts, Constraints(np.zeros(0, dtype=np.int32), none, none, none)])

    @property
    def has_friction(self) -> bool:
        """Tell whether some contact has."""
        return any(interface.rough for interface in self.interfaces)

    def partners(self, x: PETSc.Vec) -> list[Partners | None]:
        """Return where the nodes of contacts with friction are on their masters; collective.

        Args:
            x: (n,) positions at the last commit.
        """
        return [find_partners(link, x) if link.interface.rough else None for link in self.links]

    def slip_limits(
        self,
        moved: PETSc.Vec,
        limits: Sequence[Floats | None],
        partners: Sequence[Partners | None],
    ) -> SlipLimits | None:
        """Return the limits of friction, None if there is none; collective.

        Args:
            moved: (n,) displacement since the last commit.
            limits: (owned nodes,) coefficients or tractions, for each interface that has them.
            partners: of each interface when the step began, None for those of the moment.
        """
        parts = []
        for link, limit, partner in zip(self.links, limits, partners, strict=True):
            if limit is not None and isinstance(link.interface, Contact):
                slip = link.relative(moved) if partner is None else partner.slip(link, moved)
                weight = link.coupling.weight
                at = link.nodes, link.constrained, link.frames
                parts.append(link.interface.slip_limits(*at, slip, weight, limit))
        return join_limits(parts) if parts else None

    def largest_slip(self, u: PETSc.Vec, jumps: Mapping[int, PETSc.Vec]) -> float:
        """Return by how much tied sides miss their jumps at most; collective.

        Before the first pairing nobody knows: then how large the jumps are.

        Args:
            u: (n,) displacement.
            jumps: as for `constraints`.
        """
        if not self.links:
            return max((v.norm(PETSc.NormType.INFINITY) for v in jumps.values()), default=0.0)
        missed: list[Floats] = [np.zeros(0)]
        for k, link in enumerate(self.links):
            if not link.interface.one_sided:
                missed.append(link.relative(_without(u, jumps, k))[link.constrained])
        largest = np.abs(np.concatenate(missed)).max(initial=0.0)
        return float(maximum(self.V.mesh.comm, largest)[0])

    def slots(self) -> Ints:
        """Return (owned nodes, d): the unknown of each node that is a Cartesian component."""
        d = self.V.dofmap.index_map_bs
        slot: Ints = np.tile(np.arange(d, dtype=np.int32), (self.n, 1))
        for link in self.links:
            carries = link.constrained.any(axis=1)
            nodes, own = link.nodes[carries], link.slot[carries]
            slot[nodes] = np.where(own >= 0, own, slot[nodes])
        return slot


def _without(v: PETSc.Vec, jumps: Mapping[int, PETSc.Vec] | None, k: int) -> PETSc.Vec:
    """Return v less the jump of interface k, v itself where it has none."""
    return v if not jumps or k not in jumps else v - jumps[k]
