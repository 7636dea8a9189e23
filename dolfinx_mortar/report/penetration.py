# SPDX-License-Identifier: MIT
"""Overlaps of boundaries: of sides between nodes, of bodies without an interface, of tools."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

from dolfinx import fem
from dolfinx_mortar.algebra.parallel import any_rank, maximum
from dolfinx_mortar.common.arrays import HALF_OF_DIGITS, Bools, Floats, Longs
from dolfinx_mortar.common.spaces import with_ghosts
from dolfinx_mortar.common.step_report import Note
from dolfinx_mortar.geometry.facets import (
    LINE2,
    TRI3,
    Facets,
    are_inside,
    area_vectors,
    facet_normals,
    facet_sizes,
    points_of,
)
from dolfinx_mortar.geometry.flat import (
    bounds,
    flat_parts,
    near_others,
    near_pairs,
)
from dolfinx_mortar.geometry.flat import find_overlaps as overlaps_of_facets
from dolfinx_mortar.geometry.plane import count as parts
from dolfinx_mortar.geometry.plane import parts_of
from dolfinx_mortar.interfaces.link import Link
from dolfinx_mortar.interfaces.tool import SidePattern, Tool, find_facing
from dolfinx_mortar.mortar.facing_bodies import boxes_of
from dolfinx_mortar.mortar.operators import whole_facets
from dolfinx_mortar.mortar.pairing import received_facets
from dolfinx_mortar.mortar.passing import depth_of_point
from dolfinx_mortar.mortar.surface import Surface, coordinates, facets_at, nodal_sagittas
from dolfinx_mortar.problem.contacts import DIGIT
from dolfinx_mortar.problem.problem import ContactProblem

SUNK = 0.05
"""Share of the size of a facet up to which sides may lie in each other without a note.

In 280 steps of the tests it is .04 at most, apart from the sagittas of facets; a corner between
nodes penetrates as far as it is pressed.
"""
MEAN = (
    "Gaps are means over facets of the slave, of those at X with geometry='reference': let the "
    "finer or sharper side be the slave, or refine there; where Dirichlet data prescribe all nodes "
    "of slave facets nothing holds the master: let the other side be the slave. With displacements "
    "of degree 2 a node on an axis has no multiplier: refine until others touch, or take degree 1. "
    "A tool that is sharper than the facets may be rounded"
)
ITSELF = (
    "Its contact with itself has no pairs there: take smaller steps, finer facets, or a tag for "
    "each of the parts"
)
APART = (
    "Give them a Contact, or add these facets to the sides of one; where sides run around a body "
    "that is thinner than twice the overlap, tag only faces that touch"
)


@dataclass(frozen=True)
class Overlap:
    """Deepest overlap of boundaries."""

    share: float  # depth over the size of the smaller facet
    depth: float
    place: Sequence[float]
    bodies: Sequence[int] = ()


def notes_on_overlaps(
    problem: ContactProblem,
    found: Mapping[int, Overlap],
    closed: Bools | None = None,
    rtol: float = 0.0,
) -> list[str]:
    """Note for each contact whose sides overlap deeply at some point; collective.

    `closed` (owned nodes,), None for a stricter check; `rtol`: allowed overlap in facet lengths.
    """
    notes, links = list[str](), problem.system.links
    for k, link in enumerate(links):
        some, limit = found.get(k), SUNK
        if tool := link.interface.tool:
            some = _in_tool(link, tool, problem.u)
        elif link.pairing and (bare := _on_prescribed_facets(link, problem.u)):
            some = bare if some is None or bare.share > some.share else some
        elif closed is not None and not any_rank(problem.comm, closed[link.nodes].any())[0]:
            # without closed nodes only the step's tolerance, times ten for points between nodes
            limit = rtol / DIGIT
        if some is not None and some.share > limit:
            notes.append(_note(f"{link.interface}: the sides", some, MEAN))
    return notes


def _on_prescribed_facets(link: Link, u: fem.Function) -> Overlap | None:
    """Deepest point of slave facets without multipliers, by Dirichlet data; collective."""
    comm, bare = link.sides.V.mesh.comm, link.prescribed_facets()
    if not any_rank(comm, bare.any())[0]:
        return None
    pairing, segments = link.mortar[0], link.mortar[1].segments
    own, master = pairing.slave, received_facets(pairing, u)
    slave, some = facets_at(own, coordinates(own, u)), bare[segments.slave]
    s, m = segments.slave[some], segments.master[some]
    x, y = points_of(slave, s, segments.xi_s[some]), points_of(master, m, segments.xi_m[some])
    depth = ((y - x) * facet_normals(master)[m]).sum(axis=1)
    off = _deviations(own, u, link.interface.feature_angle) + _removed(link)
    depth -= off[own.facets].max(axis=1)[s]
    depth[(depth <= 0.0) | (depth >= pairing.deepest[segments.pair[some]])] = 0.0
    return _overlap(comm, depth, np.minimum(facet_sizes(slave.x)[s], facet_sizes(master.x)[m]), x)


def notes_on_crossings(problem: ContactProblem, found: Mapping[int, Overlap]) -> list[str]:
    """Note on overlaps without an interface; collective."""
    if (some := found.get(-1)) is None or some.share <= SUNK:
        return []
    one, other = (_point(x) for x in problem.bodies.centre[list(some.bodies)])
    if one == other:
        return [_note(f"no interface sees that parts of the body around {one}", some, ITSELF)]
    who = f"no interface couples the bodies around {one} and {other}, which"
    return [_note(who, some, APART)]


def _note(who: str, found: Overlap, why: str) -> Note:
    part = f"{found.share:.0%}" if found.share >= 0.01 else f"{found.share:.1g}"
    seen = f"lie {found.depth:.3g} deep in each other around {_point(found.place)}"
    return Note(f"{who} {seen}, {part} of the finer facet there", why)


def _point(x: Iterable[float]) -> str:
    return f"({', '.join(f'{c:.4g}' for c in x)})"


def _in_tool(link: Link, tool: Tool, u: fem.Function) -> Overlap | None:
    assert isinstance(link.pattern, SidePattern) and link.pattern.side is not None
    side, pose, x = link.pattern.side, tool.pose(), coordinates(link.sides.slave, u)
    facing = find_facing(side, tool, x)
    segments, points = whole_facets(side, x, facing)
    nodes = x[side.slave.facets]
    sizes, places = facet_sizes(nodes), np.concatenate([points, nodes.mean(axis=1)[facing]])
    facets = facets_at(side.slave, x)
    corners, n = nodes[:, facets.element.vertices], facet_normals(facets)
    point = np.broadcast_to(pose.to_space(tool.shape.point[None]), (len(n), x.shape[1]))
    above = ((point - corners.mean(axis=1)) * n).sum(axis=1)
    below = depth_of_point(link.sides.V.mesh.comm, tool.seen()) - above
    met = (above >= -sizes) & (below > 0.0) & are_inside(corners, n, point)
    depth = np.concatenate([-tool.distance(places).value, below[met]])
    which = np.concatenate([segments.slave, np.flatnonzero(facing), np.flatnonzero(met)])
    off = _deviations(side.slave, u, link.interface.feature_angle) + _removed(link)
    off = off[side.slave.facets].max(axis=1)
    places = np.concatenate([places, point[met]])
    return _overlap(link.sides.V.mesh.comm, depth - off[which], sizes[which], places)


def _removed(link: Link) -> Floats:
    """Depth (local slave nodes,) of removed material, see `Contact`."""
    offset = link.coupling.offset
    return np.zeros(len(link.sides.slave.nodes)) if offset is None else np.maximum(offset, 0.0)


def _overlap(comm: MPI.Comm, depth: Floats, size: Floats, place: Floats) -> Overlap | None:
    """Deepest point (n,) of all ranks, beside facets of a size; collective."""
    found = _deepest(comm, np.zeros(len(depth), np.int64), depth / size, depth, place)
    return Overlap(*found[0]) if found else None


def _deviations(surface: Surface, u: fem.Function, feature_angle: float) -> Floats:
    # nodal sagittas are means, perhaps half of the largest
    return 2.0 * nodal_sagittas(surface, coordinates(surface, u), feature_angle)


def _deepest(comm: MPI.Comm, group: Longs, *columns: Any) -> dict[int, Any]:
    """Columns at the maximum of the first one over all ranks, by group; collective."""
    order = np.argsort(columns[0], kind="stable")
    last = {int(k): i for k, i in zip(group[order], order, strict=True)}
    mine = {k: [column[i].tolist() for column in columns] for k, i in last.items()}
    every = comm.allgather(mine)
    known = {k for found in every for k in found}
    return {k: max(found[k] for found in every if k in found) for k in sorted(known)}


def find_overlaps(problem: ContactProblem) -> dict[int, Overlap]:
    """Deepest overlap at X + u of contacts' sides, and of uncoupled boundaries (-1); collective.

    Minus jumps of ties, and sagittas of both sides.
    """
    links, comm = problem.system.links, problem.comm
    itself: Bools = np.array([s.meet_themselves for s in problem.system.sides], dtype=bool)
    if problem.bodies.count == 1 and not itself.any():
        return {}
    own = _create_skin(problem, itself)
    low, high = bounds(own["x"])
    box = low.min(axis=0, initial=np.inf), high.max(axis=0, initial=-np.inf)
    sent = [  # to ranks with facets there
        own[((low <= most) & (high >= least)).all(axis=1) & (rank != comm.rank)]
        for rank, (least, most) in enumerate(comm.allgather(box))
    ]
    skin = np.concatenate([own, *comm.alltoall(sent)])
    pairs, group = _near_pairs(skin, itself)
    depth, place = overlaps_of_facets(skin["x"], skin["off"], pairs)
    ties = [k for k, link in enumerate(links) if not link.unilateral]
    here = (pairs[:, 0] < len(own)) & ~np.isin(group, ties) & (depth > 0.0)
    group, pairs, depth, place = group[here], pairs[here], depth[here], place[here]
    jumps = [link.apart() for link in links]
    longest = [0.0 if v is None else np.linalg.norm(v, axis=1).max(initial=0.0) for v in jumps]
    if links:
        one, other = skin["on"][pairs].swapaxes(0, 1)
        tied = (one & other[:, ::-1]).any(axis=1)
        depth -= (tied * maximum(comm, *longest)).max(axis=1, initial=0.0)
    columns = depth / skin["size"][pairs].min(axis=1), depth, place, skin["body"][pairs]
    return {k: Overlap(*found) for k, found in _deepest(comm, group, *columns).items()}


def _near_pairs(skin: npt.NDArray[Any], itself: Bools) -> tuple[Longs, Longs]:
    """Near facets (p, 2) of two bodies, or in self-contact; coupling interface (p,) or -1.

    Sides of an interface are coupled where they face each other.
    """
    x, body, sides = skin["x"], skin["body"], skin["sides"]
    count = int(body.max(initial=-1)) + 1
    own = np.zeros(count, dtype=bool)
    surface = sides.any(axis=1) & itself
    own[body[surface.any(axis=1)]] = True
    pairs = near_pairs(x, body, ~np.eye(count, dtype=bool) | np.diag(own))
    one, other = pairs.T
    alike = body[one] == body[other]
    a, b = pairs[alike].T
    apart = np.abs(x[a][:, :, None] - x[b][:, None]).max(axis=3).min(axis=(1, 2))
    common = apart <= HALF_OF_DIGITS * skin["size"][a]  # equal on all ranks despite round-off
    alike[alike] = common | ~(surface[a] & surface[b]).any(axis=1)
    one, other = (pairs := pairs[~alike]).T
    n = facet_normals(Facets(LINE2 if x.shape[2] == 2 else TRI3, x))
    coupled = (sides[one] & sides[other][:, ::-1]).any(axis=1)
    coupled &= ((n[one] * n[other]).sum(axis=1) < -HALF_OF_DIGITS)[:, None]
    none = np.ones((len(pairs), 1), dtype=bool)
    group = np.column_stack([coupled, none]).argmax(axis=1)
    return pairs, np.where(group == len(itself), -1, group)


def _create_skin(problem: ContactProblem, itself: Bools) -> npt.NDArray[Any]:
    """Flat facets (m,) near other bodies, or on surfaces in self-contact; collective.

    Fields: body, x (d, d), off: distance of sides from their facets, size: root of the area of the
    whole facet in space, sides and on (2, interfaces): on each side, and on or next to it.
    """
    boundary, interfaces, d = problem.system.boundary, problem.system.sides, problem.d
    facets, many = boundary.at(problem.u), len(interfaces)
    body = problem.bodies.of_cells[boundary.cells].astype(np.int64)
    sides = np.zeros((len(body), 2, many), dtype=bool)
    own_at = np.zeros((problem.n, 1 + 2 * many))
    for k, interface in enumerate(interfaces):
        for j, surface in enumerate(interface.surfaces):
            sides[:, j, k] = np.isin(boundary.entities, surface.entities)
            own = surface.nodes[: surface.owned]
            off = _deviations(surface, problem.u, problem.system.interfaces[k].feature_angle)
            if j == 0 and problem.system.links:
                off = off + _removed(problem.system.links[k])
            own_at[own, 0] = np.maximum(own_at[own, 0], off[: surface.owned])
            own_at[own, 1 + j * many + k] = 1.0
    for k in np.flatnonzero(itself):
        pairing = problem.system.links[k].pairing
        assert pairing is not None and pairing.roles is not None
        slaves = interfaces[k].slave.entities[pairing.roles.slave]
        sides[:, 0, k] = np.isin(boundary.entities, slaves)
        sides[:, 1, k] &= ~sides[:, 0, k]
    at = with_ghosts(problem.V, own_at)
    boxes = boxes_of(problem.comm, facets.x, body, problem.bodies.count)
    near = near_others(facets.x, body, boxes) | (sides.any(axis=1) & itself).any(axis=1)
    on = at[boundary.nodes[near]].max(axis=1, initial=0.0)
    size = np.linalg.norm(area_vectors(facets[near]), axis=1) ** (1 / (d - 1))
    x = flat_parts(parts_of(facets[near]))
    # quadrilaterals are two triangles
    of = np.resize(np.arange(len(size)).repeat(parts(facets.element)), len(x))
    kinds = [("body", np.int64), ("x", float, (d, d)), ("off", float), ("size", float)]
    kinds += [("sides", bool, (2, many)), ("on", bool, (2, many))]
    skin = np.empty(len(x), kinds)
    skin["body"], skin["x"], skin["size"] = body[near][of], x, size[of]
    skin["sides"], skin["off"] = sides[near][of], on[of, 0]
    skin["on"] = on[of, 1:].reshape(len(x), 2, many) > 0.0
    return skin
