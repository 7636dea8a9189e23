# SPDX-License-Identifier: MIT
"""Interfaces between two sides of the mesh, coupled by dual mortar operators."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any

import numpy as np

from dolfinx import fem
from dolfinx.mesh import MeshTags
from dolfinx_mortar.algebra.parallel import any_rank
from dolfinx_mortar.arguments import check, one_of
from dolfinx_mortar.arrays import Bools, Floats, Ints
from dolfinx_mortar.geometry.segments import Segments
from dolfinx_mortar.interfaces.contact_tangent import ContactDerivatives
from dolfinx_mortar.interfaces.coupling import (
    CoupledSides,
    Coupling,
    Frame,
    Pattern,
    Sides,
    couple_in,
    create_pattern,
    free_directions,
)
from dolfinx_mortar.interfaces.interface import FEATURE_ANGLE, Interface
from dolfinx_mortar.mortar.common_normals import common_normals
from dolfinx_mortar.mortar.curvature_correction import find_smooth_sides
from dolfinx_mortar.mortar.duals import Coverage, find_coverage, node_weights
from dolfinx_mortar.mortar.facing_bodies import check_angle
from dolfinx_mortar.mortar.integrals import drop_far, find_segments
from dolfinx_mortar.mortar.operators import SmoothSides, create_operators
from dolfinx_mortar.mortar.pairing import Pairing, create_pairing
from dolfinx_mortar.tags import label, tag_of

SURFACES = one_of("smooth", "facets")


class MortarInterface(Interface):
    """A tagged slave and master side, coupled by D and M.

    Args:
        facet_tags: facet markers on the mesh of the displacement.
        slave: tag or name (see `Tags`) of the nonmortar side.
        master: tag or name of the mortar side.
        surface: "facets", or "smooth" for smooth surfaces through the nodes.
        feature_angle: least angle of an edge between facets in degrees.

    Raises:
        ValueError: for invalid arguments.
    """

    def __init__(
        self,
        facet_tags: MeshTags,
        *,
        slave: int | str,
        master: int | str,
        surface: str = "smooth",
        feature_angle: float = FEATURE_ANGLE,
    ) -> None:
        super().__init__(facet_tags, slave=slave)
        self.master = tag_of(facet_tags, master, "master")
        if self.slave == self.master and not self.unilateral:
            raise ValueError(
                f"slave and master are both tag {label(facet_tags, self.slave)}: give two "
                "different tags"
            )
        self.smooth = check("surface", surface, SURFACES) == "smooth"
        self.feature_angle = check_angle(feature_angle)

    def __repr__(self) -> str:
        said = "" if self.smooth else ", surface='facets'"
        if self.smooth and self.feature_angle != FEATURE_ANGLE:
            said = f", feature_angle={self.feature_angle:g}"
        master = label(self.facet_tags, self.master)
        return f"{super().__repr__()[:-1]}, master={master}{said})"

    def given(self) -> dict[str, Any]:
        """See `Interface.given`."""
        return super().given() | {
            "master": self.master,
            "surface": "smooth" if self.smooth else "facets",
            "feature_angle": self.feature_angle,
        }

    def reach(self, sizes: Floats, nearest: float) -> Floats:
        """Largest distances (q,) of paired points, by facet diameters and the least distance."""
        return np.full(len(sizes), np.inf)

    @abstractmethod
    def may_carry(self, left: Floats, fixed: Bools) -> Bools:
        """Nodes (n, c) that may have a multiplier, for c choices of direction.

        Args:
            left: (n,) length of the unit normals without prescribed directions.
            fixed: (n, d) directions with Dirichlet data.
        """

    @abstractmethod
    def frame(self, normals: Floats, kept: Bools, fixed: Bools) -> Frame:
        """Frames for unit normals (n, d), kept nodes (n, c), fixed directions (n, d)."""

    @abstractmethod
    def blocks(self, P: Floats, frame: Frame, row: Ints) -> Floats:
        """Entries (e, d, d) of Q for P (e, c) in rows (e,)."""

    @abstractmethod
    def corrections(self, smooth: SmoothSides) -> dict[str, SmoothSides]:
        """Arguments of `create_operators` for smooth surfaces."""

    def pair(
        self,
        sides: Sides,
        u: fem.Function | None,
        *,
        again: bool,
        earlier: tuple[Pairing | None, Pattern] | None = None,
    ) -> tuple[Pairing, Pattern]:
        """See `Interface.pair`; collective."""
        assert sides.master is not None
        known, pattern = (None, None) if earlier is None else earlier
        options = {"again": again, "weight": sides.weight, "earlier": known}
        surfaces = sides.slave, sides.master
        pairing = create_pairing(sides.V, *surfaces, u, moving=u is not None, **options)
        if known is not None and pattern is not None and pairing.D is known.D:
            return pairing, pattern
        smooth = nearby = None
        if sides.shapes:
            at = pairing, sides.fixed, self.feature_angle
            found = find_smooth_sides(*at, sides.shapes)
            smooth, nearby = (found, None) if self.smooth else (None, found)
        entries = pairing.row, pairing.column, len(pairing.off_diagonal)
        return pairing, create_pattern(sides, *entries, smooth, nearby)

    def find_partners(self, pairing: Pairing, u: fem.Function | None) -> tuple[Segments, Floats]:
        """Coupled segments at X + u, and the slave normals; collective."""
        segments, normals = find_segments(pairing, u)
        if self.within != np.inf:
            segments = drop_far(pairing, segments, u, self.reach)
        return segments, normals

    def measure_coverage(
        self, sides: Sides, pairing: Pairing | None, u: fem.Function | None
    ) -> Coverage:
        """See `Interface.measure_coverage`; collective."""
        assert pairing is not None
        segments, _ = self.find_partners(pairing, u)
        return find_coverage(pairing, segments, *node_weights(pairing, segments))

    def derivatives(self, link: CoupledSides) -> ContactDerivatives | None:
        """See `Interface.derivatives`; collective."""
        return ContactDerivatives(link) if self.unilateral else None

    def couple(
        self,
        sides: Sides,
        pairing: Pairing | None,
        pattern: Pattern,
        banned: Bools,
        u: fem.Function | None,
    ) -> Coupling:
        """See `Interface.couple`; collective."""
        assert pairing is not None
        comm, slave, own = sides.V.mesh.comm, sides.slave, slice(None, sides.slave.owned)
        segments, averaged = self.find_partners(pairing, u)
        # planes of symmetry continue the side by its image
        normals, _ = free_directions(averaged, sides.mirrors[slave.nodes])
        fixed, free = sides.fixed[slave.nodes], ~banned[slave.nodes, None]
        _, left = free_directions(normals, fixed)
        allowed = self.may_carry(left, fixed) & free
        options = {} if pattern.smooth is None else self.corrections(pattern.smooth)
        operators = create_operators(pairing, u, segments, normals, allowed, **options)
        common = None
        if sides.spreads is not None:
            at = pairing, segments, operators.M[:, 0], u, averaged
            common = common_normals(*at, sides.spreads, self.feature_angle)
            normals = common.everywhere(slave)
            _, left = free_directions(normals, fixed)
            may = self.may_carry(left, fixed)
            if any_rank(comm, (operators.kept & ~may[own]).any())[0]:
                allowed &= may
                operators = create_operators(pairing, u, segments, normals, allowed, **options)
        kept = operators.kept
        frame = self.frame(normals[own], kept, fixed[own])
        blocks = self.blocks(operators.P, frame, pattern.row)
        if operators.motions is not None:
            blocks[pattern.split :] += operators.motions
        return couple_in(
            frame,
            kept,
            blocks=blocks,
            P=operators.P,
            weight=operators.weight,
            heights=operators.heights,
            coverage=operators.coverage,
            operators=operators,
            common=common,
        )
